"""`truewrench discover`: an equation for what no effect explains, tested on another motion; or none."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from diagnosis.discovery.discovery import Discovery, discover
from diagnosis.screening.score_test import model_initial_values
from estimation.fit import fit_case
from modeling.errors import InputError
from truewrench.commands.effect_choice import custom_effects, with_effects_changed
from truewrench.commands.results import print_result, provenance_of, suspicions_named
from truewrench.files.case_files import read_case
from truewrench.files.model_file import ModelFile
from truewrench.files.output import atomic_write, progress_line


def run(arguments: argparse.Namespace) -> None:
    """Discover, write the effects file of --out, print the terms."""
    saved = None if arguments.model is None else ModelFile.read(arguments.model)
    if saved is not None and arguments.given:
        what = "a model and effects were given"
        raise InputError(what=what, where="--given", remedy="the model has its effects: leave out one of the two")
    rig = arguments.rig if arguments.rig is not None or saved is None else saved.rig
    case = read_case(
        arguments.recordings,
        validation=arguments.validate,
        rig=rig,
        period=arguments.period,
        one_run=arguments.no_period,
        read=arguments.read,
        as_read=arguments.as_read,
        loads=arguments.load,
    )
    custom = custom_effects(arguments.effects, case)
    if saved is not None:
        custom, given = (*custom, *saved.model.effects), [effect.id for effect in saved.model.effects]
    else:
        given = arguments.given
    case = replace(case, model=with_effects_changed(case.model, given, [], custom))
    with suspicions_named((*case.recordings, *case.held_out)), progress_line() as progress:
        progress("fit")
        start = model_initial_values(case)
        if saved is not None:
            start = {**(start or {}), **{name: e.value for name, e in saved.parameters.items() if "." in name}}
        fitted = fit_case(case, start=start)
        discovery = discover(
            fitted, case.recordings, validate=case.held_out, complexity=arguments.complexity, progress=progress
        )

    def written() -> list[Path]:
        files: list[Path] = []
        if arguments.out is not None and discovery.found:
            others = arguments.out.with_stem(f"{arguments.out.stem}_alternatives")
            texts = {arguments.out: discovery.effects_toml, others: discovery.alternatives_toml}
            files = [out for out, text in texts.items() if text]
            for out in files:
                with atomic_write(out) as path:
                    path.write_text(texts[out], encoding="utf-8")
        return files if arguments.report is None else [*files, *write_report(arguments, discovery)]

    print_result(arguments, lambda: discovery, discovery.to_data, written)


def write_report(arguments: argparse.Namespace, discovery: Discovery) -> list[Path]:
    """Write the report of --report; return its files."""
    from truewrench.reports.discovery_report import discovery_report  # with its templates and figures

    inputs = (arguments.rig, arguments.effects, arguments.model)
    provenance = provenance_of(arguments, *arguments.recordings, *arguments.validate, *inputs)
    return discovery_report(discovery, provenance).write(arguments.report)
