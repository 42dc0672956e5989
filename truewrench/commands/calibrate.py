"""`truewrench calibrate`: the false-alarm rate and the power that one recording gives."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from diagnosis.calibrate import DRAWS, POWER_DRAWS, calibrate
from truewrench.commands.effect_choice import candidate_effects, custom_effects, with_effects_changed
from truewrench.commands.results import print_result, suspicions_named
from truewrench.files.calibration_file import write_calibration
from truewrench.files.case_files import read_case
from truewrench.files.output import progress_line
from truewrench.options import available_cores


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, write the file of --out, print rates and powers."""
    case = read_case([arguments.recording], rig=arguments.rig, period=arguments.period, one_run=arguments.no_period)
    custom = custom_effects(arguments.effects, case)
    case = replace(case, model=with_effects_changed(case.model, arguments.given, [], custom))
    candidates = candidate_effects(case, arguments.only, arguments.without, custom)
    with suspicions_named(case.recordings), progress_line() as progress:
        calibration = calibrate(
            case.model,
            case.recordings[0],
            effects=candidates,
            draws=DRAWS if arguments.draws is None else arguments.draws,
            power_draws=POWER_DRAWS if arguments.power_draws is None else arguments.power_draws,
            seed=arguments.seed,
            progress=progress,
            workers=available_cores() if arguments.workers is None else arguments.workers,
        )

    def written() -> list[Path]:
        if arguments.out is None:
            return []
        write_calibration(calibration, arguments.out)
        return [arguments.out]

    print_result(arguments, lambda: calibration, calibration.to_data, written)
