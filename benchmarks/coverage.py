"""Coverage: how often 95 % intervals hold the truth, by simulation on a rig that shares no equation with the models.

`python -m benchmarks.coverage [DRAWS]` prints the table (default 200 draws of the noise a case). Columns:

normal    theta ± 1.96 std with `Fit.covariance`, as if the noise were known
student   `estimation.confidence_intervals.intervals`: Student's quantile with the freedom of the estimated noise, and
          for single runs the spectrum that the autoregression left
Each with the 95 % interval of the share itself (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209-212): parameters of one
kind share their noise, so that the draws are counted, and the parameters of a draw only as far as they differ.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from estimation.bootstrap import bootstrap
from estimation.confidence_intervals import Intervals, intervals
from estimation.fit import Fit, fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from estimation.robust_fit import robust_fit
from estimation.robust_loss import Huber, Loss
from modeling import effects
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space
from modeling.table import Table
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

LEVEL, NORMAL = 0.95, 1.959964
DRAWS = 200
"""Draws of the noise a case: coverage of 0.95 is then known to ± 0.03."""
EXACT = 1e-9
"""Steps (rad, m) of resolvers fine enough that the motion is no source of error: what is studied is the readings'."""
RIGS: Mapping[Space, simulated.SimulatedRig] = {
    Space.PLANE: simulated.PlanarRig(resolver_step=EXACT),
    Space.SPACE: simulated.SpatialRig(resolver_step=EXACT, position_step=EXACT),
}
BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")


@dataclass(frozen=True, kw_only=True)
class LowPassedNoise(simulated.NoiseModel):
    """White noise through a Butterworth filter of some order, and a white floor.

    `corner` relative to the sampling rate, `floor` to the std of the noise. At 0.4 of the rate one of order 2 at 0.1
    leaves 1e-4 of the power that it passes, less than what leaks from there in a record of a thousand samples; at half
    the rate nothing.
    """

    corner: float
    floor: float = 0.0
    order: int = 2

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Filtered from a thousand samples before the record."""
        sections = butter(self.order, 2 * self.corner, output="sos")
        size = np.linalg.norm(sosfilt(sections, np.eye(1, 1000)[0]))
        filtered = sosfilt(sections, rng.standard_normal((samples + 1000, channels)), axis=0)[1000:] / size
        return np.asarray(filtered + self.floor * rng.standard_normal((samples, channels)))


NOISES: Mapping[str, simulated.NoiseModel] = {
    "white": simulated.WhiteNoise(),
    "AR 0.95": simulated.AutoregressiveNoise(rho=0.95),
    "AR 0.98": simulated.AutoregressiveNoise(rho=0.98),
    "1/f and lines": simulated.PinkNoise(),
    "t4": simulated.StudentNoise(degrees=4.0),
    "order 8": LowPassedNoise(corner=0.05, order=8),
}


class Silence(simulated.NoiseModel):
    """No noise."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Zeros."""
        return np.zeros((samples, channels))


@dataclass(frozen=True)
class Spiked(simulated.NoiseModel):
    """Another noise, and spikes of `size` std in a share `rate` of the readings."""

    noise: simulated.NoiseModel
    rate: float = 0.01
    size: float = 20.0

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """The noise, then spikes of either sign."""
        series = self.noise.draw(rng, samples, channels)
        hit = rng.random(series.shape) < self.rate
        return np.asarray(series + hit * self.size * rng.choice([-1.0, 1.0], series.shape))


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What is recorded: rig, motion and what is hidden, whether a std is stated, and the model with its truth."""

    space: Space = Space.PLANE
    repeats: int = 8
    samples: int = 200
    rest: bool = False
    stated: bool = False
    hidden: tuple[simulated.HiddenEffect, ...] = ()
    added: tuple[str, ...] = ()
    amounts: tuple[tuple[str, float], ...] = ()
    start: tuple[tuple[str, float], ...] = ()

    @property
    def model(self) -> WrenchModel:
        """The rigid tool and the effects that were added."""
        stated = Rig(sensor=SensorDescription(convention=Convention.ON_TOOL))
        base = planar() if self.space is Space.PLANE else spatial(stated)
        return base + [effects.named(name) for name in self.added]

    @property
    def truth(self) -> dict[str, float]:
        """Every parameter by name."""
        return true_tool(RIGS[self.space]) | dict(self.amounts)

    def drawn(self, noise: simulated.NoiseModel, seed: int) -> Recording:
        """A recording with this noise, of the rig's size."""
        silent, rig = silent_recording(self), RIGS[self.space]
        series = noise.draw(np.random.default_rng(seed), silent.samples, len(rig.channels))
        return silent.with_readings(silent.wrench + series * np.array(rig.noise))


def true_tool(rig: simulated.SimulatedRig) -> dict[str, float]:
    """Zero and tool of a simulated rig, by the models' names."""
    biases = {f"bias_{channel}": value for channel, value in zip(rig.channels, rig.bias, strict=True)}
    if isinstance(rig, simulated.PlanarRig):
        return biases | {"m": rig.mass, "mlg": rig.mlg, "I": rig.inertia}
    assert isinstance(rig, simulated.SpatialRig)
    return biases | dict(zip(BODY, (rig.mass, *rig.first_moment, *rig.inertia), strict=True))


@cache
def silent_recording(setting: Setting) -> Recording:
    """The setting's recording without noise."""
    rig = RIGS[setting.space]
    if setting.rest:
        frame = simulated.static_poses(rig, setting.samples, noise=Silence(), seed=5)
    else:
        frame = simulated.simulate(
            rig, rig.random_motion(seed=5), hidden=setting.hidden, repeats=setting.repeats,
            samples_per_period=setting.samples, noise=Silence(),
        )  # fmt: skip
    left_out = {"temperature"} | ({"repeat"} if setting.repeats == 1 else set())
    columns = {str(name): frame[name].to_numpy(dtype=float) for name in frame if name not in left_out}
    links = rig.link_lengths if isinstance(rig, simulated.PlanarRig) else None
    noise = dict(zip(rig.channels, rig.noise, strict=True)) if setting.stated else None
    return from_columns(columns, rig=Rig(link_lengths=links, sensor=SensorDescription(noise=noise)))


class Estimator(ABC):
    """From a recording to intervals, and the std that a normal interval would take."""

    @abstractmethod
    def __call__(self, setting: Setting, recording: Recording) -> tuple[Intervals, Array]:
        """Intervals of every unknown, and its analytic std (k,)."""


@dataclass(frozen=True)
class LeastSquares(Estimator):
    """`fit` and `intervals`."""

    def fitted(self, setting: Setting, recording: Recording) -> Fit:
        """The fit."""
        return fit(setting.model, recording, start=dict(setting.start))

    def __call__(self, setting: Setting, recording: Recording) -> tuple[Intervals, Array]:
        """Analytic."""
        found = self.fitted(setting, recording)
        return intervals(found, level=LEVEL), np.sqrt(np.diag(found.covariance))


@dataclass(frozen=True)
class Bootstrapped(LeastSquares):
    """`fit` and the t interval of its bootstrap over repeats."""

    def __call__(self, setting: Setting, recording: Recording) -> tuple[Intervals, Array]:
        """From the scatter of the repeats alone."""
        found = bootstrap(self.fitted(setting, recording), level=LEVEL)
        return Intervals(found.fit, LEVEL, found.std, found.freedom), found.std


@dataclass(frozen=True)
class Robust(Estimator):
    """`robust_fit` and its intervals."""

    loss: Loss = field(default_factory=Huber)

    def __call__(self, setting: Setting, recording: Recording) -> tuple[Intervals, Array]:
        """Analytic, of the M-estimate."""
        found = robust_fit(setting.model, recording, loss=self.loss, start=dict(setting.start))
        return found.intervals(LEVEL), np.sqrt(np.diag(found.fit.covariance))


@dataclass(frozen=True, eq=False)
class Coverage:
    """Hits (draws, parameters) of one kind of parameter, by the normal and by Student's interval."""

    case: str
    kind: str
    normal: NDArray[np.bool_]
    student: NDArray[np.bool_]
    freedom: float

    def row(self) -> tuple[str, ...]:
        """Case, kind, draws, both shares with their intervals, and the median freedom, as text."""
        shares = (f"{hits.mean():.3f} ({low:.3f}-{high:.3f})" for hits in (self.normal, self.student)
                  for low, high in [share_interval(hits)])  # fmt: skip
        return (self.case, self.kind, str(len(self.normal)), *shares, f"{self.freedom:.3g}")


def share_interval(hits: NDArray[np.bool_], level: float = NORMAL) -> tuple[float, float]:
    """Wilson's interval of the mean of (draws, parameters); parameters count by how little they go together.

    A draw's mean of g independent hits varies by p (1 - p) / g; the g that it really varied by lies between 1 and g.
    """
    share, draws = float(hits.mean()), len(hits)
    own = float(hits.mean(axis=1).var(ddof=1))
    worth = float(np.clip(share * (1 - share) / own, 1.0, hits.shape[1])) if own > 0 else 1.0
    n = draws * worth
    centre, reach = share + level**2 / (2 * n), level * np.sqrt(share * (1 - share) / n + level**2 / (4 * n**2))
    return float((centre - reach) / (1 + level**2 / n)), float((centre + reach) / (1 + level**2 / n))


def kind_of(name: str) -> str:
    """What sort of quantity a parameter is."""
    if name.startswith("bias"):
        return "bias"
    if "." in name:
        return "effect"
    return "mass" if name == "m" else "first moment" if name.startswith("m") else "inertia"


def covered(
    case: str, setting: Setting, noise: simulated.NoiseModel, estimator: Estimator, seeds: Sequence[int]
) -> Iterator[Coverage]:
    """Coverage of each kind of parameter that the recordings show."""
    truth, normal, student, freedom, kinds = setting.truth, [], [], [], list[str]()
    for seed in seeds:
        found, std = estimator(setting, setting.drawn(noise, seed))
        names = [p.name for p in found.fit.unknowns]
        kept = [i for i, name in enumerate(names) if name in truth and found.fit.identifiable[i]]
        error = np.abs(found.fit.theta - np.array([truth.get(name, np.nan) for name in names]))
        normal.append((error <= NORMAL * std)[kept])
        student.append((error <= found.half_width)[kept])
        freedom.append(found.freedom[kept])
        kinds = [kind_of(names[i]) for i in kept]
    for kind in dict.fromkeys(kinds):
        own = np.flatnonzero(np.array(kinds) == kind)
        hits, own_freedom = [np.array(rows)[:, own] for rows in (normal, student)], np.array(freedom)[:, own]
        yield Coverage(case, str(kind), hits[0], hits[1], float(np.median(own_freedom)))


PLANE, SPACE = Space.PLANE, Space.SPACE
SINGLE = Setting(repeats=1, samples=600)
TETHER = Setting(
    hidden=(simulated.CableSpring(k=20.0, anchor=(1.0, 0.0, 3.0), length=1.2),),
    added=("cable_spring",),
    amounts=(("cable_spring.k", 20.0), ("cable_spring.length", 1.2)),
    start=tuple((f"cable_spring.{name}", value) for name, value in
                (("k", 15.0), ("anchor_x", 1.05), ("anchor_y", 2.95), ("length", 1.15))),
)  # fmt: skip
LAG = Setting(
    hidden=(simulated.SensorLag(),), added=("sensor_lag",), amounts=(("sensor_lag.time_constant", 0.02),)
)  # fmt: skip
Case = tuple[str, Setting, simulated.NoiseModel, Estimator]


def cases() -> Iterator[Case]:
    """All that is studied."""
    plain, huber = LeastSquares(), Robust()
    for name, noise in NOISES.items():
        for repeats in (8, 3):
            yield f"plane, {name}, {repeats} repeats", Setting(repeats=repeats), noise, plain
        yield f"plane, {name}, single run", SINGLE, noise, plain
    for name in ("white", "AR 0.98"):
        yield f"six axes, {name}, 3 repeats", Setting(space=SPACE, repeats=3), NOISES[name], plain
        yield f"six axes, {name}, single run", Setting(space=SPACE, repeats=1, samples=600), NOISES[name], plain
    for space, poses in ((PLANE, 8), (PLANE, 24), (SPACE, 8), (SPACE, 24)):
        setting = Setting(space=space, repeats=1, samples=poses, rest=True)
        yield f"{'plane' if space is PLANE else 'six axes'}, white, {poses} poses", setting, NOISES["white"], plain
    yield "plane, white, tether, 8 repeats", TETHER, NOISES["white"], plain
    yield "plane, AR 0.98, slow sensor, 8 repeats", LAG, NOISES["AR 0.98"], plain
    for name in ("white", "AR 0.98", "1/f and lines"):
        for repeats in (8, 3):
            yield f"bootstrap, {name}, {repeats} repeats", Setting(repeats=repeats), NOISES[name], Bootstrapped()
    for name in ("white", "AR 0.98", "t4"):
        yield f"Huber, {name}, 8 repeats", Setting(), NOISES[name], huber
        yield f"Huber, {name}, single run", SINGLE, NOISES[name], huber
    for name in ("white", "AR 0.98"):
        yield f"least squares, {name} and spikes, 8 repeats", Setting(), Spiked(NOISES[name]), plain
        yield f"Huber, {name} and spikes, 8 repeats", Setting(), Spiked(NOISES[name]), huber


HEADER = ("case", "parameters", "draws", "normal", "student", "freedom")


def run(draws: int = DRAWS) -> Iterator[Coverage]:
    """Coverage of every case, as it is done."""
    for case in cases():
        yield from covered(*case, seeds=range(draws))


if __name__ == "__main__":
    print(Table.of(HEADER, [found.row() for found in run(int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS)]))
