"""Discovery: forms that no catalogue has, hidden in simulated recordings: found, in the printed set, false in noise?

`python -m benchmarks.discovery [--draws N] [--nulls N] [--power P ...] [--noise NAME ...] [--repeats N ...]`

Each form is computed on the simulated rig by code that shares no equation with the models, and scaled to a whitened
power: the chi-square by which it is beyond the rigid tool on the fitted motion. On the motion held out it may be small.

exact   the term proposed is the true form
in set  it, or one of those listed beside it, is
none    no term was proposed
wrong   another form was, without the true one beside it; of nothing hidden any form is
third   share of what is hidden that the terms predict on a third motion, without noise, nothing fitted there (median
        of the draws with terms)
2 std   constants of exact forms within two of their std, of all
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from diagnosis.discovery.discovery import Discovery, discover
from estimation.model_response import model_response, predicted_readings
from estimation.multiplicity import binomial_interval
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.simulated_rig import (
    NOISE_MODELS,
    HiddenEffect,
    NoiseModel,
    PlanarRig,
    SensorEffect,
    SensorSignal,
    SpatialRig,
    ToolLoad,
    Track,
    simulate,
)

Array = NDArray[np.float64]
PERIOD, SAMPLES = 5.0, 300
"""Of the motion, s, and per period."""
MOTIONS = (1, 2, 3)
"""Seeds of the fitted motion, of the one held out, and of a third on which terms are judged."""
WARM, WARMING = 20.0, 8.0
"""°C: temperature, and by how much it changes over a recording."""


@dataclass(frozen=True, kw_only=True)
class Load(ToolLoad):
    """A force and a torque as functions of the track, times `size`."""

    id = "unlisted"
    catalogued = False
    needs_motion = True
    law: str
    size: float
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """In the world, at the point."""
        force, torque = LAWS[self.law](track)
        return self.size * force, self.size * torque


@dataclass(frozen=True, kw_only=True)
class Leak(SensorEffect):
    """A channel reads more by a function of the loads (n, p), times `size`."""

    id = "unlisted_leak"
    catalogued = False
    order = 1
    law: str
    size: float

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Add it."""
        channel, law = OF_LOADS[self.law]
        unit = np.array([c == channel for c in signal.channels])
        return signal.mapped(lambda loads: loads + self.size * law(loads)[:, None] * unit)


def _force(law: Callable[[Track], Array]) -> Callable[[Track], tuple[Array, Array]]:
    return lambda track: (law(track), np.zeros_like(track.point))


def _torque(law: Callable[[Track], Array]) -> Callable[[Track], tuple[Array, Array]]:
    return lambda track: (np.zeros_like(track.point), law(track))


def _size(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1, keepdims=True))


def _along(track: Track) -> Array:
    """Unit vectors along the tool's axis, in the world."""
    flat = track.point[:, 1].std() < 1e-6
    return np.asarray(track.turn.apply(np.array([0.0, -1.0, 0.0] if flat else [0.0, 0.0, 1.0])))


def _from_magnet(track: Track) -> Array:
    """Vectors to a place beside the simulated path, in the world."""
    return np.array(PLACES[track.point[:, 1].std() > 1e-6]) - track.point


def _depth(track: Track, level: float) -> Array:
    """How far (m) the point is below a level."""
    return np.asarray(np.maximum(0.0, level - track.point[:, 2:]))


PLACES = {False: (1.4, 0.0, 2.3), True: (0.24, 0.35, 0.17)}
"""In the plane, and in six axes, m: all motions pass it in 0.2 to 0.3 m."""
UP = np.array([0.0, 0.0, 1.0])

LAWS: Mapping[str, Callable[[Track], tuple[Array, Array]]] = {
    "cubic drag": _force(lambda t: -(_size(t.velocity) ** 2) * t.velocity),
    "fourth power": _force(lambda t: -(_size(t.velocity) ** 3) * t.velocity),
    "drag of power 1.5": _force(lambda t: -(_size(t.velocity) ** 0.5) * t.velocity),
    "drag of power 2.5": _force(lambda t: -(_size(t.velocity) ** 1.5) * t.velocity),
    "Magnus": _force(lambda t: np.cross(t.spin, t.velocity)),
    "lift": _force(lambda t: _size(t.velocity) * np.cross(_along(t), np.cross(_along(t), t.velocity))),
    "magnet": _force(lambda t: _from_magnet(t) / _size(_from_magnet(t)) ** 4),
    "charge": _force(lambda t: _from_magnet(t) / _size(_from_magnet(t)) ** 3),
    "stiffening spring": _force(lambda t: _from_magnet(t) * _size(_from_magnet(t)) ** 2),
    "eddy current": _force(lambda t: -t.velocity / _size(_from_magnet(t)) ** 3),
    "drag with height": _force(lambda t: -t.point[:, 2:] * t.velocity),
    "buoyancy": _force(lambda t: UP * np.minimum(_depth(t, 1.9), 0.2)),
    "spring below": _force(lambda t: UP * _depth(t, 1.9)),
    "viscous bath": _force(lambda t: -t.velocity * _depth(t, 1.9)),
    "ground effect": _force(lambda t: UP * np.exp(-(t.point[:, 2:] - 1.5) / 0.25)),
    "saturating drag": _force(lambda t: -t.velocity / (0.5 + _size(t.velocity))),
    "radial": _force(lambda t: -t.point * np.array([1.0, 1.0, 0.0]) * _size(t.point * np.array([1.0, 1.0, 0.0]))),
    "rotor": _torque(lambda t: np.cross(_along(t), t.spin)),
    "cubic spin": _torque(lambda t: -(_size(t.spin) ** 2) * t.spin),
    "compass": _torque(lambda t: np.cross(_along(t), np.array([0.6, 0.8, 0.0]))),
    "rudder": _force(lambda t: np.cross(_along(t), t.velocity)),
    "centrifugal": _force(lambda t: np.cross(t.spin, np.cross(t.spin, t.point))),
}
OF_LOADS: Mapping[str, tuple[str, Callable[[Array], Array]]] = {
    "product of loads": ("fx", lambda y: y[:, 1] * y[:, -1]),
    "square of a load": ("fy", lambda y: y[:, 0] ** 2),
    "load by load": ("fy", lambda y: y[:, 0] * y[:, 1]),
}
"""Channel, and law of the loads (n, p), of what is added to its reading."""
READINGS: Mapping[str, tuple[str, Callable[[pd.DataFrame], Array]]] = {
    "seventh of a turn": ("fx", lambda f: np.sin(7 * f["q2"].to_numpy() + 0.4)),
    "joint squared": ("fy", lambda f: f["q3"].to_numpy() ** 2),
    "two joints": ("fy", lambda f: np.sin(f["q2"].to_numpy()) * f["q3"].to_numpy()),
    "warm zero": ("fy", lambda f: (f["temperature"].to_numpy() - WARM) ** 2),
    "air pressure": ("fx", lambda f: f["pressure"].to_numpy() ** 2),
    "warm-up": ("tau", lambda f: np.exp(-f["time"].to_numpy() / (0.2 * f["time"].max()))),
    "rate squared": ("tau", lambda f: np.gradient(f[["q1", "q2", "q3"]].sum(axis=1), f["time"]) ** 2),
    "joint rate squared": ("fx", lambda f: np.gradient(f["q3"], f["time"]) ** 2),
}
"""Channel and law of what is added to a reading."""

COLUMNS: Mapping[str, Callable[[Array], Array]] = {
    "temperature": lambda time: WARM + WARMING * (1 - np.exp(-2 * time / time.max())),
    "pressure": lambda time: 1.0 + 0.5 * np.sin(2 * np.pi * time / 7.3),
}
"""Other columns of a recording, of the time: a slow one, and one that is not of the motion's period."""

FORMS: Mapping[str, tuple[Space, tuple[str, ...]]] = {
    "cubic drag": (Space.PLANE, ("F = c |v|^2 v at d",)),
    "fourth power": (Space.PLANE, ("F = c |v|^3 v at d",)),
    "drag of power 1.5": (Space.PLANE, ("F = c |v|^0.5 v at d",)),
    "drag of power 2.5": (Space.PLANE, ("F = c |v|^1.5 v at d",)),
    "Magnus": (Space.PLANE, ("F = c v x w at d",)),
    "magnet": (Space.PLANE, ("F = c |n|^-4 n at d",)),
    "charge": (Space.PLANE, ("F = c |n|^-3 n at d",)),
    "stiffening spring": (Space.PLANE, ("F = c |n|^2 n at d",)),
    "eddy current": (Space.PLANE, ("F = c |n|^-3 v at d",)),
    "buoyancy": (Space.PLANE, ("F = c into_y up at d", "F = into_y k at d")),
    "spring below": (Space.PLANE, ("F = c under_y up at d",)),
    "viscous bath": (Space.PLANE, ("F = c under_y v at d",)),
    "ground effect": (Space.PLANE, ("F = c falling_y up at d",)),
    "saturating drag": (Space.PLANE, ("F = c v_sat at d",)),
    "seventh of a turn": (Space.PLANE, ("fx = harmonic(7 q2)", "fx = c sin(7 q2)", "fx = c cos(7 q2)")),
    "joint squared": (Space.PLANE, ("fy = c q3^2",)),
    "two joints": (Space.PLANE, ("fy = q3 harmonic(q2)", "fy = q3 c sin(q2)")),
    "rate squared": (Space.PLANE, ("tau = c |w|^2", "T = |w|^2 h")),
    "joint rate squared": (Space.PLANE, ("fx = c dq3^2",)),
    "product of loads": (Space.PLANE, ("fx = c fy tau",)),
    "square of a load": (Space.PLANE, ("fy = c fx^2",)),
    "load by load": (Space.PLANE, ("fy = c fx fy",)),
    "warm zero": (
        Space.PLANE,
        (
            "fy = c_1 (temperature - 23.5) + c_2 (temperature - 23.5)^2",
            "fy = c_1 (temperature - 23) + c_2 (temperature - 23)^2",
            "fy = c_1 (temperature - 24) + c_2 (temperature - 24)^2",
        ),
    ),
    "air pressure": (Space.PLANE, ("fx = c pressure^2", "fx = c_1 (pressure - 1) + c_2 (pressure - 1)^2")),
    "warm-up": (Space.PLANE, ("tau = c fading",)),
    "rotor": (Space.SPACE, ("T = w x h", "T = c w x e")),
    "cubic spin": (Space.SPACE, ("T = c |w|^2 w",)),
    "compass": (Space.SPACE, ("T = e x k",)),
    "rudder": (Space.SPACE, ("F = c v x e at d",)),
    "lift": (Space.SPACE, ()),
    "centrifugal": (Space.SPACE, ("F = c w x (w x r) at d",)),
    "radial": (Space.SPACE, ("F = c |rho| rho at d",)),
    "drag with height": (Space.SPACE, ("F = c z v at d", "F = c (r.up) v at d")),
}
"""Space and formulas of each form: where there are two, they are the same; none where the grammar has none."""


class Silence(NoiseModel):
    """No noise."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Zeros."""
        return np.zeros((samples, channels))


def model_and_rig(space: Space) -> tuple[WrenchModel, PlanarRig | SpatialRig, Rig | None]:
    """The rigid tool, the simulated rig, and its description for joint angles."""
    sensor = SensorDescription(convention=Convention.ON_TOOL)
    if space is Space.PLANE:
        rig = PlanarRig()
        return planar(Rig(sensor=sensor)), rig, Rig(link_lengths=rig.link_lengths, tip_length=0.2)
    return spatial(Rig(sensor=sensor)), SpatialRig(), None


def frame(form: str | None, space: Space, size: float, motion: int, repeats: int) -> pd.DataFrame:
    """A recording without noise."""
    _, rig, _ = model_and_rig(space)
    hidden: list[HiddenEffect] = [Load(law=form, size=size)] if form is not None and form in LAWS and size else []
    hidden += [Leak(law=form, size=size)] if form is not None and form in OF_LOADS and size else []
    simulated = simulate(
        rig, rig.random_motion(seed=motion, period=PERIOD), hidden=hidden, repeats=repeats,
        samples_per_period=SAMPLES, noise=Silence(), seed=motion,
    )  # fmt: skip
    time = simulated["time"].to_numpy()
    for column, law in COLUMNS.items():
        simulated[column] = law(time)
    if form is not None and form in READINGS:
        channel, law_of = READINGS[form]
        simulated[channel] += size * law_of(simulated)
    return simulated.drop(columns=[c for c in COLUMNS if form not in OTHER_COLUMNS[c]])


OTHER_COLUMNS = {"temperature": (None, "warm zero"), "pressure": (None, "air pressure")}
"""Forms whose recordings have a column; those with nothing hidden have all."""


def unit_power(form: str, space: Space, repeats: int) -> float:
    """Chi-square of a form of size one beyond the rigid tool on the fitted motion, in white noise of the rig's size."""
    _, rig, _ = model_and_rig(space)
    small = 1e-3  # loads of a leak are those of the tool
    plain, hidden = (frame(form, space, size, MOTIONS[0], repeats) for size in (0.0, small))
    channels = list(rig.channels)
    added = (hidden[channels] - plain[channels]).to_numpy() / np.array(rig.noise) / small
    rows = rigid_columns(space, plain) / np.array(rig.noise)[:, None]
    flat = np.tile(rows, (len(added) // len(rows), 1, 1)).reshape(-1, rows.shape[-1])
    left = added.ravel() - flat @ np.linalg.lstsq(flat, added.ravel(), rcond=1e-9)[0]
    return float(left @ left)


def rigid_columns(space: Space, plain: pd.DataFrame) -> Array:
    """Derivatives (n, p, k) of the rigid tool's readings, by the model that is fitted."""
    model, _, _ = model_and_rig(space)
    recording = recorded(plain, space, "plain")
    return model_response(model, recording, np.zeros(len(model.parameters))).derivative


def recorded(simulated: pd.DataFrame, space: Space, name: str) -> Recording:
    """As a recording; a single run without a count of repeats."""
    columns = {str(c): simulated[c].to_numpy(dtype=float) for c in simulated}
    if columns["repeat"].max() == 0:
        del columns["repeat"]
    return from_columns(columns, name=name, rig=model_and_rig(space)[2])


@dataclass(frozen=True)
class Trial:
    """One discovery: what was hidden, in which noise, and what came out."""

    form: str | None
    space: Space
    power: float
    noise: str
    repeats: int
    seed: int
    complexity: int = 6

    def run(self) -> Outcome:
        """Draw the noise and discover."""
        _, rig, _ = model_and_rig(self.space)
        size = 0.0 if self.form is None else (self.power / unit_power(self.form, self.space, self.repeats)) ** 0.5
        several = []
        for motion in MOTIONS[:2]:
            simulated = frame(self.form, self.space, size, motion, self.repeats)
            rng = np.random.default_rng([self.seed, motion, self.repeats, len(self.noise)])
            draws = NOISE_MODELS[self.noise].draw(rng, len(simulated), len(rig.channels))
            simulated[list(rig.channels)] += draws * np.array(rig.noise)
            several.append(recorded(simulated, self.space, f"motion {motion}"))
        started = time.process_time()
        model = model_and_rig(self.space)[0]
        found = discover(model, several[0], validate=several[1], complexity=self.complexity)
        seconds = time.process_time() - started
        third = recorded(frame(self.form, self.space, size, MOTIONS[2], self.repeats), self.space, "third")
        return Outcome.of(self, found, third_share(found, third), seconds)


def third_share(found: Discovery, third: Recording) -> float:
    """Share of what is beyond the rigid tool on a third motion without noise that the terms predict, as fitted."""
    _, rig, _ = model_and_rig(found.first.model.space)
    noise, left = np.array(rig.noise), []
    for fitted in (found.first, found.last):
        values = {name.partition("@")[0]: value for name, value in fitted.values.items()}
        theta = np.array([values[p.name] for p in fitted.model.parameters])
        left.append(float((((third.wrench - predicted_readings(fitted.model, third, theta)) / noise) ** 2).sum()))
    return 1 - left[1] / left[0]


@dataclass(frozen=True)
class Outcome:
    """What a trial found: the formulas proposed, whether the true one is among those, or among the listed ones.

    third    share on a third motion
    within   constants of the first term within two of their std, of all; counted where it is exact
    """

    trial: Trial
    formulas: tuple[str, ...]
    exact: bool
    in_set: bool
    third: float
    within: tuple[int, int]
    seconds: float

    @classmethod
    def of(cls, trial: Trial, found: Discovery, third: float, seconds: float) -> Outcome:
        """Of a discovery."""
        true = FORMS[trial.form][1] if trial.form else ()
        formulas = tuple(equation.formula for equation in found.equations)
        space = found.first.model.space
        listed = {o.term.printed(space) for e in found.equations for o, _ in e.found.alternatives}
        exact = bool(formulas) and formulas[0] in true
        within = (0, 0)
        if exact and trial.form is not None and trial.form in LAWS:
            size = (trial.power / unit_power(trial.form, trial.space, trial.repeats)) ** 0.5
            known = {"c": size, "d": Load.d}
            pairs = [(abs(v), std, known[n]) for n, (v, std, _) in found.equations[0].parameters.items() if n in known]
            within = (sum(abs(v - true) < 2 * std for v, std, true in pairs), len(pairs))
        in_set = exact or bool(set(true) & {*formulas, *listed})
        return cls(trial, formulas, exact, in_set, third, within, seconds)


def results_table(outcomes: Sequence[Outcome]) -> Table:
    """A row for each form, power, noise and number of repeats, and for all of them but what has nothing hidden."""
    cells = [(o.trial.form or "nothing", o.trial.power, o.trial.noise, o.trial.repeats) for o in outcomes]
    several = {
        cell: [o for o, own in zip(outcomes, cells, strict=True) if own == cell] for cell in dict.fromkeys(cells)
    }
    for power, noise, repeats in dict.fromkeys(cell[1:] for cell in cells):
        of_all = [
            o for cell, own in several.items() if cell[1:] == (power, noise, repeats) for o in own if o.trial.form
        ]
        several |= {("all", power, noise, repeats): of_all} if of_all else {}
    rows = []
    for cell, own in several.items():
        none = sum(not o.formulas for o in own)
        wrong = sum(bool(o.formulas) and not o.in_set for o in own)
        low, high = binomial_interval(wrong, len(own), 0.95)
        thirds = [o.third for o in own if o.formulas and o.trial.form]
        within = np.sum([o.within for o in own], axis=0)
        counts = (sum(o.exact for o in own), sum(o.in_set for o in own), none, wrong)
        of_third = f"{np.median(thirds):.1%}" if thirds else ""
        seconds = float(np.median([o.seconds for o in own]))
        in_two_std = f"{within[0]} of {within[1]}"
        rows.append((*cell, len(own), *counts, f"{low:.1%} to {high:.1%}", of_third, in_two_std, seconds))
    counted = ("hidden", "power", "noise", "repeats", "draws", "exact", "in set", "none", "wrong", "wrong, 95 %")
    return Table.of((*counted, "third", "2 std", Column("CPU s", format=".1f")), rows)


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--forms", nargs="*", default=list(FORMS), choices=list(FORMS))
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--power", type=float, nargs="*", default=[200.0])
    parser.add_argument("--noise", nargs="*", default=["white"], choices=list(NOISE_MODELS))
    parser.add_argument("--repeats", type=int, nargs="*", default=[4])
    parser.add_argument("--spaces", nargs="*", default=[s.name for s in Space], help="of those with nothing hidden")
    parser.add_argument("--complexity", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.draws)
    cells = list(product(options.noise, options.repeats))
    trials = [
        Trial(form, FORMS[form][0], power, noise, repeats, seed, options.complexity)
        for form, power, (noise, repeats), seed in product(options.forms, options.power, cells, seeds)
    ]
    spaces = [Space[name] for name in options.spaces]
    trials += [
        Trial(None, spaces[seed % len(spaces)], 0.0, noise, repeats, seed, options.complexity)
        for (noise, repeats), seed in product(cells, range(options.seed, options.seed + options.nulls))
    ]
    outcomes = []
    with ProcessPoolExecutor(options.workers) as pool:
        for outcome in pool.map(Trial.run, trials):
            outcomes.append(outcome)
            t = outcome.trial
            said = f"{t.form} {t.power:g} {t.noise} x{t.repeats} #{t.seed}: {'; '.join(outcome.formulas) or 'none'}"
            said += f" | {outcome.third:.1%}" if outcome.formulas else ""
            mark = "=" if outcome.exact else "~" if outcome.in_set else "-" if not outcome.formulas else "WRONG"
            print(f"{len(outcomes)}/{len(trials)} {mark} {said} {outcome.seconds:.0f} s", file=sys.stderr, flush=True)
    print(results_table(outcomes))


if __name__ == "__main__":
    main()
