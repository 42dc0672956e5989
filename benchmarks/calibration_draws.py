"""Draws from a prior of recordings: rig, motion, what is hidden and how large, noise; and what is said of each of them.

The recordings are MuJoCo's (`truewrench.simulated_rig`), with resolvers so fine that the motion is no source of error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from benchmarks.coverage import NOISES, RIGS, Silence, true_tool
from diagnosis.comparison.comparison import comparison_of
from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.screening.score_test import ScoreTest, screen
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from estimation.fit import fit, unchecked_fit
from estimation.multiplicity import bonferroni_level, gamma_isf
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.effects import catalogue, named
from modeling.parameter import Role
from modeling.rig import Convention, Rig, SensorDescription
from modeling.significance import LEVELS
from modeling.space import Space
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

RATE, PERIODS, RUN = 50.0, (3.0, 6.0), 3
"""Rows per second; lengths of a repeat, s; a run without repeats is as many times as long."""
DRAWS = 99
"""Of the posterior, so that a rank is one of a hundred."""
SIZE_OF_HIDDEN = (0.0, 1.0, 3.0)
"""Of an effect that is diagnosed, over the stated detectable size, each in a third of the recordings."""


@dataclass(frozen=True, kw_only=True)
class LowPassed(simulated.NoiseModel):
    """White noise behind a Butterworth filter of second order, `cutoff` over the sampling rate, and a white floor."""

    cutoff: float = 0.1
    floor: float = 0.01

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """After a thousand samples that come to no account."""
        sections, ahead = butter(2, self.cutoff, fs=1.0, output="sos"), 1000
        impulse = sosfilt(sections, np.eye(ahead)[0])
        series = sosfilt(sections, rng.standard_normal((ahead + samples, channels)), axis=0)[ahead:]
        return np.asarray(series / np.linalg.norm(impulse) + self.floor * rng.standard_normal((samples, channels)))


KINDS_OF_NOISE: Mapping[str, tuple[simulated.NoiseModel, float]] = {
    "white": (NOISES["white"], 0.0),
    "AR 0.95": (NOISES["AR 0.95"], 0.0),
    "1/f": (simulated.PinkNoise(tones=()), 0.0),
    "1/f, tones": (NOISES["1/f and lines"], 0.0),
    "low-passed": (LowPassed(), 0.0),
    "by speed": (NOISES["white"], 1.0),
}
"""Noise of unit variance, and by how many times itself its std grows from rest to the rms speed of the joints.

Tones have frequencies of their own in each recording, a quarter of a turn or more off the motion's repeats: nearer,
they are physics to two repeats."""
TONE = "line_interference"
"""What tones are called, where they are in the noise: not false there."""


@dataclass(frozen=True)
class Hidden:
    """An effect of the prior.

    amplitude  name of the parameter in the catalogue, in the plane and in six axes
    usual      its size (of a gain, the error)
    made       the simulated effect of a size at a place by the catalogue's names, empty for the simulator's own
    alone      whether the simulator can hide that amplitude alone
    """

    amplitude: tuple[str, str]
    usual: float
    made: Callable[[float, Mapping[str, float]], simulated.HiddenEffect]
    alone: bool = True


def _tether(k: float, at: Mapping[str, float]) -> simulated.CableSpring:
    """In the plane the anchor's y is upwards."""
    place = {name: value for name, value in at.items() if not name.startswith("anchor")}
    x, y, z = (at.get(f"anchor_{axis}", 0.0) for axis in "xyz")
    anchor = (x, y, z) if "anchor_z" in at else (x, 0.0, y)
    return simulated.CableSpring(k=k, anchor=anchor if at else None, **place)


HIDDEN: Mapping[str, Hidden] = {
    "viscous_drag": Hidden(("c", "c"), 0.15, lambda size, at: simulated.ViscousDrag(c=size, **at)),
    "cable_spring": Hidden(("k", "k"), 3.0, _tether),
    "joint_offset": Hidden(("offset_2", ""), 0.02, lambda size, _: simulated.JointOffset(offset=size)),
    "gravity_tilt": Hidden(("angle", "tilt_y"), 0.03, lambda size, _: simulated.GravityTilt(tilt_y=size)),
    "sensor_lag": Hidden(("time_constant",) * 2, 0.02, lambda size, _: simulated.SensorLag(time_constant=size)),
    "time_delay": Hidden(("delay",) * 2, 0.012, lambda size, _: simulated.TimeDelay(delay=size)),
    "sensor_gain": Hidden(("fy", "fy"), 0.03, lambda size, _: simulated.SensorGain(errors=(("fy", size),))),
    "payload_change": Hidden(("mass", "mass"), 0.05, lambda size, at: simulated.PayloadChange(mass=size, **at)),
    "thermal_drift": Hidden(
        ("fx", "fx"), 0.2, lambda size, _: simulated.ThermalDrift(force=size, torque=size / 20), alone=False
    ),
}
"""The effects that are hidden, by id; nothing is hidden as often as each of them."""


def drawn_rig(space: Space, rng: np.random.Generator) -> simulated.SimulatedRig:
    """The rig with another tool and zero, none of them known to the fit.

    Mass 0.5 to 1.5 times its own, lengths 0.6 to 1.4 times, inertia beyond these 0.9 to 1.3 times (uniform); zero
    normal about its own, with ten std of a sample.
    """
    rig = RIGS[space]
    mass, size, shape = rng.uniform(0.5, 1.5), rng.uniform(0.6, 1.4), rng.uniform(0.9, 1.3)
    first, second = mass * size, mass * size**2 * shape
    bias = tuple((np.array(rig.bias) + 10 * np.array(rig.noise) * rng.standard_normal(len(rig.bias))).tolist())
    if isinstance(rig, simulated.PlanarRig):
        return replace(rig, mass=mass * rig.mass, mlg=first * rig.mlg, inertia=second * rig.inertia, bias=bias)
    assert isinstance(rig, simulated.SpatialRig)
    x, y, z = (first * value for value in rig.first_moment)
    inertia = tuple(second * value for value in rig.inertia)
    return replace(rig, mass=mass * rig.mass, first_moment=(x, y, z), inertia=inertia, bias=bias)


def true_amounts(effect: simulated.HiddenEffect, space: Space) -> dict[str, float]:
    """Parameters of the catalogue's effect by full name; amplitudes that the simulated one does not have are nominal.

    The effect has its place (`resolve_effects`).
    """
    fields = {name: value for name, value in vars(effect).items() if isinstance(value, float)}
    match effect:
        case simulated.SensorGain():
            fields = {channel: 1 + error for channel, error in effect.errors}
        case simulated.JointOffset():
            fields = {f"offset_{effect.joint}": effect.offset}
        case simulated.ThermalDrift():
            fields = {c: effect.force if c.startswith("f") else effect.torque for c in space.channels}
        case simulated.GravityTilt():
            fields |= {"angle": effect.tilt_y}
        case simulated.CableSpring(anchor=(x, y, z)):
            names, place = ("xy", (x, z)) if space is Space.PLANE else ("xyz", (x, y, z))
            fields |= {f"anchor_{axis}": value for axis, value in zip(names, place, strict=True)}
    own = {p.name: p for p in named(effect.id).qualified(space)}
    nominal = {name: p.nominal for name, p in own.items() if p.role is Role.AMPLITUDE}
    return nominal | {n: value for name, value in fields.items() if (n := f"{effect.id}.{name}") in own}


@dataclass(frozen=True)
class Draw:
    """One draw: the number of a recording among those of a kind of noise and so many repeats, and what it is of."""

    noise: str
    repeats: int
    number: int
    space: Space
    period: float
    rig: simulated.SimulatedRig
    effect: str
    share: float
    seed: int
    moment: float

    @classmethod
    def of(cls, noise: str, repeats: int, number: int) -> Draw:
        """By its number: plane or six axes, length, rig, effect and size, motion and noise."""
        rng = np.random.default_rng([list(KINDS_OF_NOISE).index(noise), repeats, number])
        space = (Space.PLANE, Space.SPACE)[rng.integers(2)]
        period = PERIODS[rng.integers(len(PERIODS))] * (RUN if repeats == 1 else 1)
        ids = ["", *(i for i, hidden in HIDDEN.items() if hidden.amplitude[space is Space.SPACE])]
        rig, effect = drawn_rig(space, rng), ids[rng.integers(len(ids))]
        share, seed, moment = rng.uniform(0.5, 1.5), int(rng.integers(2**31)), rng.uniform(0.2, 0.8)
        return cls(noise, repeats, number, space, period, rig, effect, share, seed, moment)

    @property
    def hidden(self) -> tuple[simulated.HiddenEffect, ...]:
        """The effect at 0.5 to 1.5 times its usual size, with its place; none if it is nothing.

        A load is taken up in the middle 60 % of the record, between two samples.
        """
        if not self.effect:
            return ()
        time = {"time": self.moment * self.repeats * self.period} if self.effect == "payload_change" else {}
        effect = HIDDEN[self.effect].made(self.share * HIDDEN[self.effect].usual, time)
        return simulated.resolve_effects(self.rig, self._motion, (effect,), repeats=self.repeats)

    @property
    def truth(self) -> dict[str, float]:
        """Every parameter by name."""
        amounts = {name: value for e in self.hidden for name, value in true_amounts(e, self.space).items()}
        return true_tool(self.rig) | amounts

    def model(self, *ids: str) -> WrenchModel:
        """The rigid tool with these effects."""
        base = planar(self._described) if self.space is Space.PLANE else spatial(self._described)
        return base + [named(i) for i in ids]

    @property
    def _described(self) -> Rig:
        """What the fit knows of the rig: links and sign convention."""
        links = self.rig.link_lengths if isinstance(self.rig, simulated.PlanarRig) else None
        return Rig(link_lengths=links, sensor=SensorDescription(convention=Convention.ON_TOOL))

    @property
    def _motion(self) -> simulated.PeriodicMotion:
        """Up to 1 Hz."""
        return self.rig.random_motion(seed=self.seed, period=self.period, harmonics=int(self.period))

    def recording(self, hidden: Sequence[simulated.HiddenEffect], stream: int = 0) -> Recording:
        """A recording with the effects in it; noises of different streams are independent."""
        motion, rows, (noise, growth) = self._motion, round(RATE * self.period), KINDS_OF_NOISE[self.noise]
        if isinstance(noise, simulated.PinkNoise) and noise.tones:
            rng = np.random.default_rng([self.seed, 3])
            turns = rng.integers(rows // 20, 9 * rows // 20, 2) + rng.uniform(0.25, 0.75, 2)
            noise = replace(noise, tones=tuple((turns / rows).tolist()))
        frame = simulated.simulate(
            self.rig, motion, hidden=hidden, repeats=self.repeats, samples_per_period=rows,
            noise=Silence(), seed=self.seed,
        )  # fmt: skip
        columns = {str(n): frame[n].to_numpy(dtype=float) for n in frame if self.repeats > 1 or n != "repeat"}
        speed = np.linalg.norm(motion.evaluate(columns["time"])[1], axis=1)
        std = 1 + growth * speed / np.sqrt(np.mean(speed**2))
        series = noise.draw(np.random.default_rng([self.seed, stream]), len(frame), len(self.rig.channels))
        series *= (std / np.sqrt(np.mean(std**2)))[:, None] * np.array(self.rig.noise)
        columns |= {c: columns[c] + own for c, own in zip(self.rig.channels, series.T, strict=True)}
        return from_columns(columns, rig=self._described)


# -------------------------------------------------------------------------------------------- what is said of one


@dataclass(frozen=True)
class Rank:
    """Of the true value of one parameter of a kind among the posterior's draws, and its distance from the estimate
    over the half width of the 95 % interval."""

    kind: str
    parameter: str
    rank: int
    distance: float = np.nan


@dataclass(frozen=True)
class Fitted:
    """Ranks of one parameter of each kind, and the p-value of lack of fit."""

    ranks: tuple[Rank, ...]
    lack_of_fit: float


@dataclass(frozen=True)
class Said:
    """What a diagnosis said of a recording with an effect of `size` times its detectable size, or with none.

    added        what it named, but for tones where they are
    holds        whether what it named, with what it calls confusable, holds the effect
    significant  whether the effect's score test is, at the level that the detectable size is for
    """

    verdict: RecordVerdict
    added: tuple[str, ...]
    hidden: str = ""
    size: float = 0.0
    holds: bool = False
    significant: bool = False

    @property
    def false(self) -> bool:
        """Whether it names only others; of nothing, whether it names something or leaves something unexplained."""
        if self.hidden:
            return bool(self.added) and not self.holds
        return bool(self.added) or self.verdict not in (RecordVerdict.NOTHING_MISSING, RecordVerdict.EXPLAINED)


def fitted(draw: Draw) -> Fitted:
    """Of a fit with the hidden effect that begins at the truth. Raises InputError where the recording is refused."""
    hidden, model = draw.hidden, draw.model(*(effect.id for effect in draw.hidden))
    truth = {p.name: draw.truth[p.name] for p in model.parameters if p.name in draw.truth}
    result = fit(model, draw.recording(hidden), start=truth)
    ends, names = result.intervals(LEVELS.confidence), [p.name for p in result.unknowns]
    kept = [i for i, name in enumerate(names) if name in truth and 0 < ends.half_width[i] < np.inf]
    names, rng = [names[i] for i in kept], np.random.default_rng([draw.seed, 2])
    error = np.array([truth[name] for name in names]) - result.theta[kept]
    covariance = (result.ordinary or result).covariance[np.ix_(kept, kept)]
    ranks, together = posterior_ranks(error, ends.std[kept], ends.freedom[kept], covariance, rng)
    kinds = np.array(["bias" if n.startswith("bias") else "effect" if "." in n else "tool" for n in names])
    chosen = [int(rng.choice(np.flatnonzero(kinds == kind))) for kind in dict.fromkeys(kinds.tolist())]
    distance = np.abs(error) / ends.half_width[kept]
    each = [Rank(str(kinds[i]), names[i], int(ranks[i]), float(distance[i])) for i in chosen]
    return Fitted((*each, Rank("together", "", together)), comparison_of(result, 0).lack_of_fit)


def diagnosed(draw: Draw) -> Said:
    """With the whole catalogue, of a recording in which the drawn effect is hidden by the size and at the place that
    another recording of the same states as detectable; of nothing where none is stated. Raises InputError."""
    size, model = SIZE_OF_HIDDEN[draw.number % len(SIZE_OF_HIDDEN)], draw.model()
    hidden = HIDDEN.get(draw.effect)
    if size and hidden is not None and hidden.alone:
        before = _scores(draw, model, draw.recording((), stream=1))
        stated = {name.split(".")[1]: float(v) for test in before for name, v in test.detectable.items()}
        place = {name.split(".")[1]: float(v) for test in before for name, v in test.detectable_at.items()}
        amount = size * stated.get(hidden.amplitude[draw.space is Space.SPACE], np.inf)
        if np.isfinite(amount):
            recording = draw.recording((hidden.made(amount, place),))
            tests, told = _scores(draw, model, recording), diagnose(model, recording)
            confused = {i for f in told.findings if f.effect.id in told.added for i in f.confusable_with}
            holds = draw.effect in confused.union(effect.id for effect in told.fit.model.effects)
            level = bonferroni_level(_candidates(draw.space))
            significant = all(test.excited and test.p_value < level for test in tests)
            return Said(told.verdict, _without_tones(draw, told), draw.effect, size, holds, significant)
    told = diagnose(model, draw.recording(()))
    return Said(told.verdict, _without_tones(draw, told))


def _without_tones(draw: Draw, told: Diagnosis) -> tuple[str, ...]:
    return tuple(i for i in told.added if i != TONE or "tones" not in draw.noise)


def _scores(draw: Draw, model: WrenchModel, recording: Recording) -> list[ScoreTest]:
    """Of the drawn effect, as one of the catalogue; none of a tilt that is in the model, as gravity shows it."""
    null = unchecked_fit(Case.of(model, (recording,)))
    return screen(null, [named(draw.effect)], candidates=_candidates(draw.space))


def _candidates(space: Space) -> int:
    return sum(space in effect.spaces for effect in catalogue())


def posterior_ranks(
    error: Array, std: Array, freedom: Array, covariance: Array, rng: np.random.Generator
) -> tuple[NDArray[np.intp], int]:
    """Number of the posterior's draws below the truth, which is `error` (k,) beyond the estimate; and of those that are
    nearer to the estimate than the truth is, in the covariance (k, k).

    Draws are normal with its correlation, and with the std over sqrt(chi-square / freedom), the chi-squares of all at
    one probability: each parameter's are Student's t.
    """
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 1e-12))
    widths = np.sqrt(freedom / 2 / gamma_isf(rng.random((DRAWS, 1)), freedom / 2))
    draws = np.vstack([error / std, widths * (rng.standard_normal((DRAWS, len(error))) @ root.T)])
    distance = np.linalg.norm(np.linalg.solve(root, draws.T), axis=0)
    return (draws[1:] < draws[0]).sum(axis=0), int((distance[1:] < distance[0]).sum())
