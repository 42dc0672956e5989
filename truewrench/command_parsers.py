"""Arguments of every command, in the order of `--help`; no command and no numerical library is imported here."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from modeling.codegen.code_target import BUILT_IN, CALIBRATIONS, FORMATS
from modeling.significance import LEVELS
from truewrench.options import (
    PRESETS,
    Subcommands,
    add_candidate_choice,
    add_custom_effects,
    add_effect_changes,
    add_effect_ids,
    add_loads,
    add_no_period,
    add_period,
    add_readings,
    add_recordings,
    add_repeatable,
    add_report,
    add_workers,
    body_of,
    duration,
    finite,
    named_size,
    positive,
    worker_count,
)

MAX_DRAWS = 4096
"""Surrogates of one calibration: a rate of false alarms is then known to a hundredth."""

SURVEY_FOLDER = Path("survey")

SERIES = ("free", "paper", "spline", "rest")

CRITERIA = ("d", "a", "e")

MAX_COUNT = 1_000_000
"""Limit of counted options: more does not fit into memory."""


def demo(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `demo`."""
    text = "Simulate a rig with a hidden physical effect, diagnose its recordings, and compare with the truth."
    command: argparse.ArgumentParser = commands.add_parser(
        "demo", help="diagnose a simulated rig with a hidden effect", description=text
    )
    text = "effect to hide, or `nothing` (default: %(default)s)"
    command.add_argument("--effect", metavar="ID", default="cable_spring", help=text)
    text = "folder for rig file, recordings and report (default: %(default)s)"
    command.add_argument("--out", type=Path, metavar="DIR", default=Path("demo_report"), help=text)
    return command


def import_recording(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `import`."""
    text = "Read logs as robots write them (text, Parquet, Excel, MATLAB, NumPy, HDF5, ROS bags, LeRobot data sets;"
    text += (
        " several files, several clocks), and write one recording by --out. The reading report says what was done to"
    )
    text += " how many samples."
    command: argparse.ArgumentParser = commands.add_parser(
        "import", help="logs of robots as a recording", description=text
    )
    command.add_argument(
        "sources",
        nargs="+",
        metavar="SOURCE",
        help="log file, folder of a ROS 2 bag, or LeRobot episode: DATASET/episode_000000; one run",
    )
    command.add_argument(
        "--preset", metavar="NAME", help=f"layout of the log (default: recognised): {', '.join(PRESETS)}"
    )
    command.add_argument("--map", metavar="FILE", help='columns and units in TOML, such as fx = "wrench.force.x"')
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML): the arm of joint angles, and [columns]")
    period = command.add_mutually_exclusive_group()
    period.add_argument("--period", type=positive, metavar="T", help="period of a repeated motion, s: cut into repeats")
    period.add_argument("--no-period", action="store_true", help="one run, even if a column counts repeats")
    text = "stamp of the wrench minus stamp of the motion at one instant, s (default: estimated); 0 believes the stamps"
    command.add_argument("--clock-offset", type=finite, metavar="S", help=text)
    command.add_argument("--strict", action="store_true", help="refuse whatever would have to be mended")
    command.add_argument("--out", type=Path, metavar="REC", help="recording to write (.csv or .parquet)")
    command.add_argument("--plot", type=Path, metavar="FILE", help="picture of the reading (.png, .svg or .pdf)")
    command.add_argument("--json", action="store_true", help="print the reading report as JSON alone")
    return command


def diagnose(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `diagnose`."""
    text = "Fit the rigid tool, test its residual, and add the physical effects that explain it."
    command: argparse.ArgumentParser = commands.add_parser(
        "diagnose", help="physical effects missing from the model", description=text
    )
    add_recordings(command)
    add_loads(command)
    add_period(command)
    add_readings(command)
    add_repeatable(command, "--validate", metavar="REC2", text="recording of another motion, never fitted")
    add_candidate_choice(command)
    add_custom_effects(command)
    text = "calibration of REC, by `calibrate --out`: quoted, and p-values withheld where they do not hold"
    command.add_argument("--calibration", type=Path, metavar="FILE", help=text)
    command.add_argument("--out", type=Path, metavar="DIR", help="folder for report.html, result.json, model.json")
    add_report(command)
    add_workers(command, "accepted, and without effect: a diagnosis runs in one process")
    command.add_argument("--json", action="store_true", help="print the result as JSON alone")
    return command


def discover(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `discover`."""
    text = (
        "Look for an equation of what a model leaves unexplained: all terms of a grammar of forces, torques and zeros"
        " up to a complexity, tested on another motion with their constants as fitted."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "discover", help="an equation for what no effect explains, or none", description=text
    )
    add_recordings(command)
    add_loads(command)
    add_period(command)
    add_readings(command)
    add_repeatable(command, "--validate", metavar="REC2", text="recording of another motion, on which terms are tested")
    add_effect_ids(command, "--given", text="effect that the model has already")
    add_custom_effects(command)
    text = "model file of `fit --out` or `diagnose --out`: its effects are given, and its rig where --rig is not"
    command.add_argument("--model", type=Path, metavar="MODEL.json", help=text)
    text = "most leaves and operations of a term (default: %(default)s)"
    command.add_argument("--complexity", type=_count, metavar="K", default=6, help=text)
    command.add_argument("--out", type=Path, metavar="EFFECT.toml", help="effects file for the terms that were found")
    add_report(command)
    command.add_argument("--json", action="store_true", help="print the result as JSON alone")
    return command


def calibrate(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `calibrate`."""
    text = (
        "Diagnose surrogates of a recording, its fitted model with noise resampled from its residual: how often an"
        " effect is named that is not there, and how often one is found that is hidden at its detectable amount."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "calibrate", help="false-alarm rate and power of a recording", description=text
    )
    command.add_argument("recording", metavar="REC", help="recording (CSV or Parquet)")
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML), required for joint angles")
    add_period(command)
    add_candidate_choice(command)
    add_custom_effects(command)
    command.add_argument("--draws", type=_count, metavar="N", help="surrogates in which nothing is missing (100)")
    text = "surrogates for each effect, hidden in them (20; 0 for none)"
    command.add_argument("--power-draws", type=_count_or_none, metavar="N", help=text)
    command.add_argument("--seed", type=_count_or_none, default=0, metavar="S", help="seed of the surrogates (0)")
    command.add_argument("--out", type=Path, metavar="FILE", help="JSON file for `diagnose --calibration`")
    add_workers(command)
    command.add_argument("--json", action="store_true", help="print the result as JSON alone")
    return command


def fit(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `fit`."""
    text = "Estimate the rigid tool, with the effects given by --add, from recordings of one rig and tool."
    command: argparse.ArgumentParser = commands.add_parser(
        "fit", help="estimate the parameters of a given model", description=text
    )
    add_recordings(command)
    add_loads(command)
    add_period(command)
    add_readings(command)
    add_effect_changes(command)
    add_repeatable(command, "--validate", metavar="REC2", text="recording of another motion, compared but not fitted")
    add_custom_effects(command)
    command.add_argument("--robust", action="store_true", help="robust regression (Huber loss)")
    command.add_argument("--bounds", type=Path, metavar="FILE", help="TOML file of intervals, m = [0.1, 3.0]")
    command.add_argument(
        "--physical", action="store_true", help="physically consistent inertia only, by a margin of 1e-6"
    )
    text = (
        "the tool's mass is inside a box, --inside=XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX in m along the axes of its parameters"
    )
    text += " from the sensor's origin, or inside a mesh (.stl, .obj, in m); implies --physical"
    command.add_argument("--inside", metavar="BOX|MESH", help=text)
    command.add_argument("--prior", type=Path, metavar="FILE", help="TOML file of a reference tool and its weight")
    text = "largest error of the readings of a channel, noise and what the model lacks, N or N m"
    text += ": with that of every channel, the interval that then holds for each parameter"
    add_repeatable(command, "--error-bound", metavar="CHANNEL=SIZE", text=text, value=named_size)
    text = "TOML file of what the model takes as known, each with its std: a budget of the uncertainty"
    command.add_argument("--budget", type=Path, metavar="FILE", help=text)
    text = "a load that one has, MASS@X,Y,Z as in --load: says which of them to hang next, in which of the motions"
    add_repeatable(command, "--next-load", metavar="LOAD", text=text, value=body_of)
    text = "check the budget by N refits of readings with contributions and noise drawn at random, such as 200"
    command.add_argument("--monte-carlo", type=count, metavar="N", help=text)
    text = "read one log in chunks, as is done with long ones; derivatives are columns of the log"
    command.add_argument("--stream", action="store_true", help=text)
    command.add_argument("--runs", action="store_true", help="print mean error and variance of every repeat")
    text = "print noise, systematic residual and gain of averaging over the repeats"
    command.add_argument("--verbose", action="store_true", help=text)
    command.add_argument("--out", type=Path, metavar="MODEL.json", help="file for the model")
    add_report(command)
    command.add_argument("--json", action="store_true", help="print model and residual statistics as JSON alone")
    return command


def compare(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `compare`."""
    text = (
        "Compare fitted models on the same recordings: where each fails, by channel and frequency band, which"
        " difference is significant, and what changed in the parameters. The biases are re-estimated on each recording."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "compare", help="several models on the same recordings", description=text
    )
    command.add_argument("models", nargs="+", metavar="MODEL.json", help="model files of `fit --out`, `diagnose --out`")
    text = "recordings (CSV or Parquet) of the same rig and tool, best of a motion that no model was fitted to"
    command.add_argument("--on", nargs="+", required=True, metavar="REC", help=text)
    add_report(command)
    command.add_argument("--json", action="store_true", help="print the comparison as JSON alone")
    return command


def survey(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `survey`."""
    text = (
        "Diagnose many recordings of one rig, each by itself. A recording that cannot be diagnosed is a row with its "
        "error; an interrupted survey resumes where it stopped."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "survey", help="diagnose many recordings, locally or on a cluster", description=text
    )
    add_recordings(command)
    add_no_period(command)
    place = command.add_mutually_exclusive_group()
    place.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler")
    place.add_argument(
        "--workers", type=worker_count, metavar="N", help="processes on this machine (default: all cores)"
    )
    out = f"folder for survey.parquet, survey.html and finished outcomes (default: {SURVEY_FOLDER})"
    command.add_argument("--out", type=Path, default=SURVEY_FOLDER, metavar="FOLDER", help=out)
    command.add_argument("--json", action="store_true", help="print the rows as JSON alone")
    return command


def design(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `design`."""
    text = (
        "Optimise an exciting trajectory within the rig's limits, with an upper bound over all periodic trajectories. "
        "Interrupted (Ctrl-C, SIGTERM) it writes the best so far."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "design", help="exciting trajectory within the limits", description=text
    )
    command.add_argument("rig", metavar="RIG", help="rig file (TOML) with an arm and limits")
    command.add_argument("--model", metavar="MODEL.json", help="design for this fitted model instead of the rigid tool")
    text = "d: volume of the confidence ellipsoid; a: mean variance; e: largest variance (default: %(default)s)"
    command.add_argument("--criterion", choices=CRITERIA, default="d", help=text)
    text = "free: a Fourier series for each joint; paper: equation 22.10 of chapter 22; spline: piecewise polynomial;"
    text += " rest: free, starting and ending at standstill (default: %(default)s)"
    command.add_argument("--series", choices=SERIES, default="free", help=text)
    command.add_argument("--harmonics", type=count, default=12, metavar="H", help="of free and rest (default: 12)")
    command.add_argument("--knots", type=count, default=100, metavar="K", help="of spline (default: 100)")
    text = "of spline: 2 has discontinuous acceleration and comes closest to the bound, 3 is continuous (default: 3)"
    command.add_argument("--degree", type=count, default=3, metavar="D", help=text)
    command.add_argument("--ramp", type=positive, metavar="S", help="of rest, s (default: a tenth of the period)")
    command.add_argument("--period", type=positive, default=5.0, metavar="T", help="s (default: 5)")
    command.add_argument("--samples", type=count, default=200, metavar="N", help="of one period (default: 200)")
    command.add_argument("--tell", nargs=2, metavar=("A", "B"), help="discriminate between these two effects")
    text = (
        "the motion that this diagnosis asks for: it separates effects that were not told apart, or narrows the widest"
    )
    text += " interval; with model.json beside it, or --model"
    command.add_argument("--next", type=Path, metavar="RESULT.json", help=text)
    add_custom_effects(command)
    command.add_argument(
        "--runs", type=count, default=1, metavar="R", help="repeats of the motion, for --tell and --next (default: 1)"
    )
    text = "weight the readings by the noise of MODEL.json or the rig file; always on with --tell and --next"
    command.add_argument("--weighted", action="store_true", help=text)
    text = "Bayesian design: average over the parameter covariance of MODEL.json, where the information depends on it"
    command.add_argument("--averaged", action="store_true", help=text)
    text = "random starts (default: 24; 48 for few harmonics; 36 for degree 2; 6 for --tell, dynamics, six axes)"
    command.add_argument("--starts", type=count, metavar="S", help=text)
    command.add_argument("--seed", type=seed, default=0, metavar="S", help="of the random starts (default: 0)")
    add_workers(command)
    command.add_argument("--no-bound", action="store_true", help="skip the upper bound")
    command.add_argument(
        "--out", type=Path, metavar="PLAN.csv", help="file for the trajectory; its plot is written beside it (.png)"
    )
    text = (
        "also as a robot plays it, with --series rest, by the suffix: .yaml (ROS 2 JointTrajectory), .script (URScript,"
    )
    text += " servoj at 500 Hz), .csv (positions at 1 kHz); read back and checked against the limits; several times"
    command.add_argument("--play", type=Path, action="append", default=[], metavar="FILE", help=text)
    command.add_argument("--json", action="store_true", help="print the figures of merit as JSON alone")
    return command


def compensate(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `compensate`."""
    text = (
        "Subtract a fitted model from a recording: the wrench of the environment on the tool, with its uncertainty. In"
        " the plane, magnitude and direction in CONTACT.csv are those of the force at the tip: the point force that"
        " fits force and torque best, if the contact is at the tip and exerts no torque of its own. In six axes the"
        " magnitude is |F|."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "compensate", help="contact wrench of a recording", description=text
    )
    command.add_argument("model", metavar="MODEL.json", help="model file of `fit --out` or `diagnose --out`")
    text = "recording of the same rig and tool: CSV, Parquet, DATASET/episode_000003, with --lerobot DATASET"
    command.add_argument("recording", metavar="REC", help=text)
    text = "use the zero of the fitted recording; by default it is re-estimated from the samples without contact"
    command.add_argument("--keep-zero", action="store_true", help=text)
    text = (
        "axes of the wrench: the sensor's (default, also where it is turned; in the plane x' and y' of the tip),"
        " those of the logged pose, such as a flange's, or the base's"
    )
    command.add_argument("--axes", choices=("sensor", "pose", "base"), help=text)
    text = "distance of the force at the tip from the sensor along the tip, planar, m (default: the rig's tip_length)"
    command.add_argument("--tip-length", type=positive, metavar="M", help=text)
    text = (
        "smooth the wrench at this lag, such as 20ms: each row takes readings until so much later, weighted against the"
        " recording's own noise, and the accelerations imu_ax, imu_ay, imu_az where they lower it"
    )
    command.add_argument("--lag", type=duration, metavar="TIME", help=text)
    text = "with the budget of the model (fit --budget --out): its contributions are in every std, and in a table"
    command.add_argument("--budget", dest="with_budget", action="store_true", help=text)
    text = (
        "by the model that a diagnosis chose alone; by default the mean over those that it could not tell apart, every"
        " std with what they differ by"
    )
    command.add_argument("--without-alternatives", action="store_true", help=text)
    text = "probability of any false contact in a recording without contact (default: %(default)s)"
    command.add_argument("--false-alarms", type=chance, metavar="P", default=LEVELS.contact, help=text)
    command.add_argument("--out", type=Path, metavar="CONTACT.csv", help="file for the contact wrench of each sample")
    text = (
        "bag for PlotJuggler, Foxglove and ROS 2: readings, prediction, contact and its std, and each effect as topics"
    )
    command.add_argument("--mcap", type=Path, metavar="OUT.mcap", help=text)
    text = (
        "copy of the LeRobot data set of which REC is an episode, or all of it, with contact, its std and the"
        " prediction as features; the data set itself changes it in its place"
    )
    command.add_argument("--lerobot", type=Path, metavar="OUT", help=text)
    command.add_argument("--json", action="store_true", help="print the contacts and the zero as JSON alone")
    return command


def emit(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `emit`."""
    text = (
        "Generate code (numpy, casadi, c, latex): the regressor of a base model, or prediction and contact wrench of a"
        " fitted model, sample by sample; the operation counts are printed. Or write the identified tool as robots take"
        " it: an <inertial> of URDF, SDF or MJCF, set_payload of Universal Robots, setLoad of Franka, parameters of a"
        " ROS 2 node. Or write the sensor's calibration, a matrix with its covariance, as drivers take it."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "emit", help="write a model as code, its tool for a robot, or the sensor's calibration", description=text
    )
    explanation = "model file of `fit --out` or `diagnose --out`, or a base model: planar, spatial"
    command.add_argument("model", metavar="MODEL.json|planar|spatial", help=explanation)
    command.add_argument(
        "--to",
        required=True,
        metavar="FORMAT",
        help=f"language or format: {', '.join((*BUILT_IN, *FORMATS, *CALIBRATIONS))}",
    )
    text = "sampling rate of the code; needed for a model with lag, delay, hysteresis or a flexible tip"
    command.add_argument("--rate", type=positive, metavar="HZ", help=text)
    text = "pose of the sensor's own axes in the robot's frame, as the flange: m, and rad about fixed axes, as in URDF"
    pose = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")
    command.add_argument("--sensor-pose", type=finite, nargs=6, metavar=pose, help=text)
    text = "C with a monitor: bias, tool and changes on line; its noise and rate are those of REC, ordinary work"
    command.add_argument("--monitor", metavar="REC", help=text)
    text = "what the maker states of the sensor, to compare a calibration with: a CSV of channel, full_scale, accuracy"
    text += " (%% of it) and, under the channels' names, the matrix; or ATI's .cal, which calibration_ati corrects"
    command.add_argument("--sheet", metavar="FILE", help=text)
    command.add_argument("--out", type=Path, metavar="FILE", help="file to write (default: standard output)")
    return command


def effects(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `effects`."""
    text = "List the candidate effects of a diagnosis, or describe one in full."
    command: argparse.ArgumentParser = commands.add_parser(
        "effects", help="the catalogue of physical effects", description=text
    )
    command.add_argument("id", nargs="?", metavar="ID", help="effect to describe")
    add_custom_effects(command)
    return command


def workbench(commands: Subcommands[Any]) -> argparse.ArgumentParser:
    """Add `workbench`."""
    text = (
        "Open a page of this machine's browser: read a recording, see where the model fails, add and drop effects, "
        "diagnose, and take away report, model and code. Only this machine can reach it."
    )
    command: argparse.ArgumentParser = commands.add_parser(
        "workbench", help="the loop by hand, in a web page", description=text
    )
    command.add_argument("recordings", nargs="*", metavar="REC", help="recording or log to begin with")
    add_repeatable(command, "--validate", metavar="REC2", text="recording of another motion, never fitted")
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML), required for joint angles")
    command.add_argument("--port", type=port, default=0, metavar="N", help="port (default: any that is free)")
    command.add_argument("--no-browser", action="store_true", help="print the address, and open nothing")
    return command


def _count(text: str) -> int:
    """A whole number of surrogates, at least one."""
    if _count_or_none(text) == 0:
        raise argparse.ArgumentTypeError("at least one surrogate is needed")
    return int(text)


def _count_or_none(text: str) -> int:
    """A whole number from 0 to MAX_DRAWS."""
    if not text.isdecimal() or int(text) > MAX_DRAWS:
        raise argparse.ArgumentTypeError(f"a whole number up to {MAX_DRAWS} is needed, not {text!r}")
    return int(text)


def count(text: str) -> int:
    """A whole number above zero; argparse reports a ValueError in one line."""
    value = int(text)
    if not 1 <= value <= MAX_COUNT:
        raise ValueError(text)
    return value


def seed(text: str) -> int:
    """A whole number from zero on."""
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def chance(text: str) -> float:
    """A number between zero and one."""
    value = positive(text)
    if value >= 1:
        raise ValueError(text)
    return value


def port(text: str) -> int:
    """A port from 0 to 65535; argparse reports a ValueError in one line."""
    value = int(text)
    if not 0 <= value <= 65535:
        raise ValueError(text)
    return value
