"""A simulated single run in six axes, its diagnosis, and how far that is from the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from time import process_time

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from benchmarks.coverage import BODY
from benchmarks.robot_motions import MOTIONS
from diagnosis.diagnosis import Diagnosis, diagnose
from estimation.fit import Fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import spatial
from modeling.errors import InputError
from modeling.rig import Rig
from truewrench.simulated_rig import (
    AutoregressiveNoise,
    CableSpring,
    HiddenEffect,
    NoiseModel,
    PinkNoise,
    SensorCrosstalk,
    SpatialRig,
    WhiteNoise,
    resolve_effects,
    simulate,
)

Array = NDArray[np.float64]

RIG = SpatialRig()
SAMPLES = 1500
"""Of 15 s: 100 Hz."""
NOISES: Mapping[str, NoiseModel] = {
    "white": WhiteNoise(),
    "AR 0.95": AutoregressiveNoise(rho=0.95),
    "1/f": PinkNoise(tones=()),
    "1/f and tones": PinkNoise(),
}
KINDS = tuple(product(NOISES, MOTIONS))
"""Noise and motion of a run."""
UNSTATED = Rig.from_data({})
STATED = Rig.from_data({"sensor": {"noise": dict(zip(RIG.channels, RIG.noise, strict=True))}})
"""A rig of which nothing is known, and one with the true std of one sample."""
BASE = dict(zip((*(f"bias_{c}" for c in RIG.channels), *BODY), (*RIG.bias, RIG.mass, *RIG.first_moment, *RIG.inertia),
                strict=True))  # fmt: skip
"""True bias and body by the model's names."""
ORIENTATION, POSITION = ("qx", "qy", "qz", "qw"), ("px", "py", "pz")
FAR = 4.0
"""Std from which on a parameter counts as wrong."""


@dataclass(frozen=True, kw_only=True)
class SingleRun:
    """Noise and motion by name, one seed for both, what is hidden, and whether the rig states the noise."""

    noise: str
    motion: str
    seed: int
    hidden: tuple[HiddenEffect, ...] = ()
    stated: bool = False

    @property
    def name(self) -> str:
        """Noise, motion and seed."""
        return f"{self.noise}, {self.motion}, {self.seed}" + (", std stated" if self.stated else "")

    @property
    def noise_model(self) -> NoiseModel:
        """By its name."""
        return NOISES[self.noise]

    def frame(self) -> pd.DataFrame:
        """The log."""
        return simulate(
            RIG, MOTIONS[self.motion](self.seed), hidden=self.hidden, repeats=1, samples_per_period=SAMPLES,
            noise=self.noise_model, seed=self.seed,
        )  # fmt: skip

    def recording(self) -> Recording:
        """As it is read."""
        return recorded(self.frame(), STATED if self.stated else UNSTATED)

    @cached_property
    def truth(self) -> dict[str, float]:
        """Every parameter by name, with places that the simulation chose."""
        return truth_of(resolve_effects(RIG, MOTIONS[self.motion](self.seed), self.hidden, repeats=1))

    def outcome(self) -> Outcome:
        """Its diagnosis against the truth."""
        return Outcome.of(self.name, self.recording(), self.hidden, self.truth)


def recorded(frame: pd.DataFrame, rig: Rig = UNSTATED, repeats: bool = False) -> Recording:
    """The recording in a simulated log, as one run unless `repeats`."""
    left_out = {"temperature"} | (set() if repeats else {"repeat"})
    columns = {str(c): frame[c].to_numpy(dtype=float) for c in frame if c not in left_out}
    return from_columns(columns, name="run", rig=rig)


def truth_of(hidden: Sequence[HiddenEffect]) -> dict[str, float]:
    """Bias, body and the parameters of the effects, by the model's names."""
    return BASE | {f"{effect.id}.{name}": value for effect in hidden for name, value in _amounts(effect)}


def _amounts(effect: HiddenEffect) -> Iterator[tuple[str, float]]:
    if isinstance(effect, SensorCrosstalk):
        for out, into in product(RIG.channels, RIG.channels):
            yield f"{into}_{out}", sum(gain for i, o, gain in effect.leaks if (i, o) == (into, out))
        return
    for field in fields(effect):  # type: ignore[arg-type]
        value = getattr(effect, field.name)
        if isinstance(effect, CableSpring) and field.name == "anchor":
            yield from zip(("anchor_x", "anchor_y", "anchor_z"), value, strict=True)
        elif isinstance(value, float):
            yield field.name, value


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a diagnosis said of a run, and what is true.

    verdict     of the record, or refused: the remarks say why
    added       ids of the effects found; `hidden` of those hidden
    deviations  of the parameters whose truth is known, in std, by name
    rms         of the final residual over the std of one sample, by channel
    mass        the estimate and its std, kg
    removed     share that the effects removed
    seconds     CPU
    """

    name: str
    verdict: str
    added: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    deviations: Mapping[str, float]
    rms: tuple[float, ...] = ()
    mass: tuple[float, float] = (np.nan, np.nan)
    removed: float = np.nan
    remarks: tuple[str, ...] = ()
    seconds: float

    @classmethod
    def of(cls, name: str, recording: Recording, hidden: Sequence[HiddenEffect], truth: Mapping[str, float]) -> Outcome:
        """Diagnose with the whole catalogue."""
        begin = process_time()
        ids = tuple(effect.id for effect in hidden)
        try:
            found = diagnose(spatial(recording.rig), recording)
        except InputError as error:
            return cls(
                name=name, verdict="refused", hidden=ids, deviations={}, remarks=(str(error),),
                seconds=process_time() - begin,
            )  # fmt: skip
        mass, comparison = found.fit.parameters["m"], found.steps[-1].training[0]
        return cls(
            name=name, verdict=found.verdict.value, added=found.added, hidden=ids,
            deviations=dict(_deviations(found, truth)),
            rms=tuple(comparison.rms[c] / std for c, std in zip(RIG.channels, RIG.noise, strict=True)),
            mass=(mass.value, mass.std), removed=found.removed_share, remarks=tuple(found.remarks()),
            seconds=process_time() - begin,
        )  # fmt: skip

    @property
    def wrong(self) -> tuple[str, ...]:
        """Effects found that are not there."""
        return tuple(i for i in self.added if i not in self.hidden)

    @property
    def found(self) -> tuple[str, ...]:
        """Effects found that are there."""
        return tuple(i for i in self.hidden if i in self.added)

    @property
    def far(self) -> tuple[str, ...]:
        """Parameters more than four std off, with how many."""
        return tuple(f"{name} {z:+.1f}" for name, z in self.deviations.items() if abs(z) > FAR)

    def sentence(self) -> str:
        """The record, and what was said of it."""
        added = f" ({', '.join(self.added)})" if self.added else ""
        off = f"; off by std: {', '.join(self.far)}" if self.far else ""
        rms = f"; rms / noise {' '.join(f'{r:.3g}' for r in self.rms)}" if self.rms else ""
        return f"{self.name}: {self.verdict}{added}{rms}{off}"


def _deviations(found: Diagnosis, truth: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    for name, parameter in found.fit.parameters.items():
        if name in truth and np.isfinite(parameter.std) and parameter.std > 0:
            yield name, (parameter.value - truth[name]) / parameter.std


def ordinary_least_squares(found: Fit, weight: Array) -> Array:
    """Parameters (k,) of a fit's model by least squares, each channel weighted by its true noise std (p,)."""
    rows = found.response().derivative / weight[:, None]
    step = np.linalg.lstsq(rows.reshape(-1, rows.shape[2]), (found.residuals[0] / weight).ravel(), rcond=None)[0]
    return np.asarray(found.theta + step)


def noisy_pose(frame: pd.DataFrame, radians: float, metres: float, seed: int) -> pd.DataFrame:
    """The log with white noise of an encoder in orientation (std, rad) and position (std, m)."""
    rng, orientation, position = np.random.default_rng(seed), list(ORIENTATION), list(POSITION)
    turns = Rotation.from_rotvec(radians * rng.standard_normal((len(frame), 3)))
    frame = frame.copy()
    frame[orientation] = (Rotation.from_quat(frame[orientation].to_numpy()) * turns).as_quat()
    frame[position] = frame[position].to_numpy() + metres * rng.standard_normal((len(frame), 3))
    return frame


def held_pose(frame: pd.DataFrame, rate: float) -> pd.DataFrame:
    """The log with a pose that has new values at `rate` (Hz) only, and is held between them."""
    time, frame = frame["time"].to_numpy(), frame.copy()
    last = np.searchsorted(time, np.floor(time * rate + 1e-6) / rate - 1e-9)
    for name in (*ORIENTATION, *POSITION):
        frame[name] = frame[name].to_numpy()[last]
    return frame


def share(count: int, of: int) -> str:
    """A count, and the 95 % interval of its rate by C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404."""
    interval = binomtest(count, of).proportion_ci(0.95, method="exact")
    return f"{count}/{of} ({100 * interval.low:.1f}-{100 * interval.high:.1f} %)"
