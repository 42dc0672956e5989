"""Discovery: forms that no catalogue has, hidden in simulated recordings: found, in the printed set, false in noise?

`python -m benchmarks.discovery [--draws N] [--nulls N] [--power P ...] [--noise NAME ...] [--repeats N ...]`

Each form is computed on the simulated rig by code that shares no equation with the models, and scaled to a whitened
power: the chi-square by which it is beyond the rigid tool on the fitted motion. On the motion held out it may be small.

exact   the term proposed is the true form
in set  it, or one of those listed beside it, is
none    no term was proposed
wrong   another form was, without the true one beside it; of nothing hidden any form is
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
from estimation.multiplicity import binomial_interval
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.simulated_rig import NOISE_MODELS, NoiseModel, PlanarRig, SpatialRig, ToolLoad, Track, simulate

Array = NDArray[np.float64]
PERIOD, SAMPLES = 5.0, 300
"""Of the motion, s, and per period."""
MOTIONS = (1, 2)
"""Seeds of the fitted motion and of the one held out."""


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


def _force(law: Callable[[Track], Array]) -> Callable[[Track], tuple[Array, Array]]:
    return lambda track: (law(track), np.zeros_like(track.point))


def _torque(law: Callable[[Track], Array]) -> Callable[[Track], tuple[Array, Array]]:
    return lambda track: (np.zeros_like(track.point), law(track))


def _size(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1, keepdims=True))


def _along(track: Track) -> Array:
    """Unit vectors along the tool's axis, in the world."""
    return np.asarray(track.turn.apply(np.array([0.0, 0.0, 1.0])))


def _from_magnet(track: Track) -> Array:
    """Vectors to a place beside the simulated path, in the world: 0.3 m beyond the first point of a fixed box."""
    return np.array(PLACES[track.point[:, 1].std() > 1e-6]) - track.point


PLACES = {False: (2.0, 0.0, 2.0), True: (0.45, 0.3, 0.2)}
"""In the plane, and in six axes, m."""

LAWS: Mapping[str, Callable[[Track], tuple[Array, Array]]] = {
    "cubic drag": _force(lambda t: -(_size(t.velocity) ** 2) * t.velocity),
    "fourth power": _force(lambda t: -(_size(t.velocity) ** 3) * t.velocity),
    "Magnus": _force(lambda t: np.cross(t.spin, t.velocity)),
    "magnet": _force(lambda t: _from_magnet(t) / _size(_from_magnet(t)) ** 4),
    "eddy current": _force(lambda t: -t.velocity / _size(_from_magnet(t)) ** 3),
    "drag with height": _force(lambda t: -t.point[:, 2:] * t.velocity),
    "rotor": _torque(lambda t: np.cross(_along(t), t.spin)),
    "cubic spin": _torque(lambda t: -(_size(t.spin) ** 2) * t.spin),
    "compass": _torque(lambda t: np.cross(_along(t), np.array([0.6, 0.8, 0.0]))),
    "rudder": _force(lambda t: np.cross(_along(t), t.velocity)),
}
READINGS: Mapping[str, tuple[str, Callable[[pd.DataFrame], Array]]] = {
    "seventh of a turn": ("fx", lambda f: np.sin(7 * f["q2"].to_numpy() + 0.4)),
    "warm zero": ("fy", lambda f: (f["temperature"].to_numpy() - 20.0) ** 2),
    "rate squared": ("tau", lambda f: np.gradient(f[["q1", "q2", "q3"]].sum(axis=1), f["time"]) ** 2),
}
"""Channel and law of what is added to a reading."""

FORMS: Mapping[str, tuple[Space, tuple[str, ...]]] = {
    "cubic drag": (Space.PLANE, ("F = c |v|^2 v at d",)),
    "fourth power": (Space.PLANE, ("F = c |v|^3 v at d",)),
    "Magnus": (Space.PLANE, ("F = c v x w at d",)),
    "magnet": (Space.PLANE, ("F = c |n|^-4 n at d",)),
    "eddy current": (Space.PLANE, ("F = c |n|^-3 v at d",)),
    "seventh of a turn": (Space.PLANE, ("fx = harmonic(7 q2)", "fx = c sin(7 q2)", "fx = c cos(7 q2)")),
    "rate squared": (Space.PLANE, ("tau = c |w|^2", "T = |w|^2 h")),
    "rotor": (Space.SPACE, ("T = h x w", "T = c w x e")),
    "cubic spin": (Space.SPACE, ("T = c |w|^2 w",)),
    "compass": (Space.SPACE, ("T = e x k",)),
    "rudder": (Space.SPACE, ("F = c v x e at d",)),
    "drag with height": (Space.SPACE, ("F = c z v at d", "F = c (r.up) v at d")),
}
"""Space and formulas of each form: where there are two, they are the same."""


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
    hidden = (Load(law=form, size=size),) if form is not None and form in LAWS and size else ()
    simulated = simulate(
        rig, rig.random_motion(seed=motion, period=PERIOD), hidden=hidden, repeats=repeats,
        samples_per_period=SAMPLES, noise=Silence(), seed=motion,
    )  # fmt: skip
    if form is not None and form in READINGS:
        channel, law = READINGS[form]
        simulated[channel] += size * law(simulated)
    return simulated


def unit_power(form: str, space: Space, repeats: int) -> float:
    """Chi-square of a form of size one beyond the rigid tool on the fitted motion, in white noise of the rig's size."""
    _, rig, _ = model_and_rig(space)
    plain, hidden = (frame(form, space, size, MOTIONS[0], 1) for size in (0.0, 1.0))
    channels = list(rig.channels)
    added = (hidden[channels] - plain[channels]).to_numpy() / np.array(rig.noise)
    rows = rigid_columns(space, plain) / np.array(rig.noise)[:, None]
    flat = rows.reshape(-1, rows.shape[-1])
    left = added.ravel() - flat @ np.linalg.lstsq(flat, added.ravel(), rcond=1e-9)[0]
    return repeats * float(left @ left)


def rigid_columns(space: Space, plain: pd.DataFrame) -> Array:
    """Derivatives (n, p, k) of the rigid tool's readings, by the model that is fitted."""
    from estimation.model_response import model_response

    model, _, _ = model_and_rig(space)
    recording = recorded(plain, space, "plain")
    return model_response(model, recording, np.zeros(len(model.parameters))).derivative


def recorded(simulated: pd.DataFrame, space: Space, name: str) -> Recording:
    """As a recording; a single run without a count of repeats."""
    columns = {str(c): simulated[c].to_numpy(dtype=float) for c in simulated if c != "temperature"}
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

    @property
    def cell(self) -> tuple[str | None, float, str, int]:
        """What it has in common with others of the table's row."""
        return self.form, self.power, self.noise, self.repeats

    def run(self) -> Outcome:
        """Draw the noise and discover."""
        _, rig, _ = model_and_rig(self.space)
        size = 0.0 if self.form is None else (self.power / unit_power(self.form, self.space, self.repeats)) ** 0.5
        several = []
        for motion in MOTIONS:
            simulated = frame(self.form, self.space, size, motion, self.repeats)
            rng = np.random.default_rng([self.seed, motion, self.repeats, len(self.noise)])
            draws = NOISE_MODELS[self.noise].draw(rng, len(simulated), len(rig.channels))
            simulated[list(rig.channels)] += draws * np.array(rig.noise)
            several.append(recorded(simulated, self.space, f"motion {motion}"))
        started = time.process_time()
        model = model_and_rig(self.space)[0]
        found = discover(model, several[0], validate=several[1], complexity=self.complexity)
        return Outcome.of(self, found, time.process_time() - started)


@dataclass(frozen=True)
class Outcome:
    """What a trial found: the formulas proposed, whether the true one is among those, or among the listed ones."""

    trial: Trial
    formulas: tuple[str, ...]
    exact: bool
    in_set: bool
    seconds: float

    @classmethod
    def of(cls, trial: Trial, found: Discovery, seconds: float) -> Outcome:
        """Of a discovery."""
        true = FORMS[trial.form][1] if trial.form else ()
        formulas = tuple(equation.formula for equation in found.equations)
        space = found.first.model.space
        listed = {o.term.printed(space) for e in found.equations for o, _ in e.found.alternatives}
        exact = bool(formulas) and formulas[0] in true
        return cls(trial, formulas, exact, exact or bool(set(true) & {*formulas, *listed}), seconds)


def results_table(outcomes: Sequence[Outcome]) -> Table:
    """A row for each form, power, noise and number of repeats."""
    rows = []
    for form, power, noise, repeats in dict.fromkeys(o.trial.cell for o in outcomes):
        own = [o for o in outcomes if o.trial.cell == (form, power, noise, repeats)]
        none = sum(not o.formulas for o in own)
        wrong = sum(bool(o.formulas) and not o.in_set for o in own)
        low, high = binomial_interval(wrong, len(own), 0.95)
        seconds = float(np.median([o.seconds for o in own]))
        counts = (sum(o.exact for o in own), sum(o.in_set for o in own), none, wrong)
        rows.append((form or "nothing", power, noise, repeats, len(own), *counts, f"{low:.1%} to {high:.1%}", seconds))
    columns = ("hidden", "power", "noise", "repeats", "draws", "exact", "in set", "none", "wrong", "wrong, 95 %")
    return Table.of((*columns, Column("CPU s", format=".1f")), rows)


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--forms", nargs="*", default=list(FORMS), choices=list(FORMS))
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--power", type=float, nargs="*", default=[200.0])
    parser.add_argument("--noise", nargs="*", default=["white"], choices=list(NOISE_MODELS))
    parser.add_argument("--repeats", type=int, nargs="*", default=[4])
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
    spaces = tuple(Space)
    trials += [
        Trial(None, spaces[seed % 2], 0.0, noise, repeats, seed, options.complexity)
        for (noise, repeats), seed in product(cells, range(options.seed, options.seed + options.nulls))
    ]
    outcomes = []
    with ProcessPoolExecutor(options.workers) as pool:
        for outcome in pool.map(Trial.run, trials):
            outcomes.append(outcome)
            t = outcome.trial
            said = f"{t.form} {t.power:g} {t.noise} x{t.repeats} #{t.seed}: {'; '.join(outcome.formulas) or 'none'}"
            mark = "=" if outcome.exact else "~" if outcome.in_set else "-" if not outcome.formulas else "WRONG"
            print(f"{len(outcomes)}/{len(trials)} {mark} {said} {outcome.seconds:.0f} s", file=sys.stderr, flush=True)
    print(results_table(outcomes))


if __name__ == "__main__":
    main()
