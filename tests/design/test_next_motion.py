"""Probability of confusion that a design states, and what a next motion promises, against simulated recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from design.discrimination import DirectedPair, DiscriminationDesign, Hypothesis, discriminate, rival_models
from design.discrimination.model_pair import RivalAlongTrajectories
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory
from design.trajectory_design import design
from modeling import effects
from modeling.chain.model import spatial
from modeling.noise import NoiseModel
from modeling.rig import Convention, Rig
from modeling.rival_fit import fit_rival
from tests.shared.places import URDF
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

SAMPLES, PERIOD = 80, 8.0
SERIES = FreeSeries(joints=6, harmonics=(1, 2, 3), period=PERIOD)
ROBOT = simulated.SpatialRig(convention="on_sensor", noise=(0.0,) * 6)
"""A tool in six axes whose readings have no noise."""
NOISE = NoiseModel.white(16 * np.array(simulated.SpatialRig().noise))
"""So loud that a drag of the size below is often taken for another kind, also along the designed motion."""
DRAG = simulated.ViscousDrag(c=0.25, d=0.12)
TOOL = {
    **{f"bias_{channel}": bias for channel, bias in zip(ROBOT.channels, ROBOT.bias, strict=True)},
    **dict(zip(("m", "mx", "my", "mz"), (ROBOT.mass, *ROBOT.first_moment), strict=True)),
    **dict(zip(("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"), ROBOT.inertia, strict=True)),
}
SIZES = TOOL | {"viscous_drag.c": DRAG.c, "viscous_drag.d": DRAG.d}


@cache
def six_axes() -> Rig:
    limits = {
        "position": [[-2.0, 2.0], [-1.6, 1.2], [-1.5, 2.0], [-2.5, 1.5], [-2.0, 2.0], [-2.5, 2.5]],
        "velocity": [1.5, 1.5, 1.5, 2.0, 2.0, 2.0],
        "acceleration": [4.0, 4.0, 4.0, 8.0, 8.0, 8.0],
    }
    robot = {"urdf": str(URDF / "elbow.urdf"), "sensor_frame": "tool0", "tip_length": 0.15}
    return Rig.from_data({"robot": robot, "limits": limits, "workspace": {"z": [0.3, 1.3]}})


@dataclass(frozen=True, eq=False)
class Carried:
    """A motion of the six joints as coordinates of `SpatialRig`, by Pinocchio's kinematics and a Fourier series.

    Angles may turn as a whole in a period: they are a ramp and a periodic part. The world is turned about the vertical,
    which no reading shows, so that the middle angle stays as far as it can from a right one, where the others are none.
    """

    motion: Trajectory

    FINE = 2048
    """Instants: the coordinates' series has decayed to 1e-9 within a quarter as many lines."""

    @property
    def period(self) -> float:
        return self.motion.period

    @cached_property
    def _lines(self) -> tuple[Array, NDArray[np.complex128]]:
        """Mean rates (6,) and lines of the periodic part (F, 6)."""
        model = pinocchio.buildModelFromUrdf(str(URDF / "elbow.urdf"))
        data, frame = model.createData(), model.getFrameId("tool0")
        time = np.arange(self.FINE) * self.period / self.FINE
        origins, axes = np.empty((self.FINE, 3)), np.empty((self.FINE, 3, 3))
        for row, q in enumerate(self.motion.evaluate(time)[0]):
            pinocchio.framesForwardKinematics(model, data, np.append(q, [0.0, 0.0]))
            origins[row], axes[row] = data.oMf[frame].translation, data.oMf[frame].rotation
        yaws = Rotation.from_euler("z", np.linspace(0.0, np.pi, 36)[:, None])
        yaw = min(yaws, key=lambda yaw: np.abs((yaw.as_matrix() @ axes)[:, 0, 2]).max())
        origins, angles = yaw.apply(origins), (yaw * Rotation.from_matrix(axes)).as_euler("XYZ")
        turned = np.unwrap(np.vstack([angles, angles[:1]]), axis=0)
        rates = np.append(np.zeros(3), np.round((turned[-1] - turned[0]) / (2 * np.pi)) * 2 * np.pi / self.period)
        coordinates = np.hstack([origins, turned[:-1]]) - np.outer(time, rates)
        lines = np.fft.rfft(coordinates, axis=0)[: self.FINE // 4] / self.FINE
        assert np.abs(lines[-10:]).max() < 1e-9
        return rates, lines

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        rates, lines = self._lines
        s = 2j * np.pi / self.period * np.arange(len(lines))
        waves = np.exp(np.outer(time, s)) * np.where(s == 0, 1, 2)
        q, dq, ddq = ((waves @ (lines * s[:, None] ** order)).real for order in range(3))
        return q + np.outer(time, rates), dq + rates, ddq


@cache
def told_apart() -> DiscriminationDesign:
    """Of viscous from quadratic drag, beside the D-optimal motion of the same model."""
    model = replace(spatial(six_axes()), convention=Convention.ON_SENSOR)
    truth, rival = rival_models(model + effects.viscous_drag(), effects.viscous_drag(), effects.quadratic_drag())
    options = {"series": SERIES, "samples": SAMPLES, "noise": NOISE, "starts": 1}
    exciting = design(six_axes(), model=truth, values=SIZES, bounded=False, **options).motion  # type: ignore[arg-type]
    return discriminate(six_axes(), truth, SIZES, [rival], exciting=exciting, **options)  # type: ignore[arg-type]


@pytest.mark.long(16)
@pytest.mark.parametrize("name", ["D-optimal", "designed"])
def test_probability_of_confusion_is_that_of_recordings_of_the_motion(name: str) -> None:
    """A drag in MuJoCo, Pinocchio's arm; both models fitted to 200 noisy recordings, wrong is the lower chi-square.

    Wrong choices within binomial tails of 1e-4 together, so that one other seed in 1e4 fails. The mean by which the
    rival's chi-square is higher is lambda, with the std 2 sqrt(lambda / 200): four of them, one in 16 000.
    """
    plan, draws = told_apart(), 200
    (pair,) = plan.pairs
    forward = pair.directions[0]
    motion = plan.exciting if name == "D-optimal" else plan.motion
    stated = pair.exciting if name == "D-optimal" else pair.after
    assert motion is not None
    assert stated is not None
    assert stated == (forward.exciting if name == "D-optimal" else forward.after)  # the less separated direction
    chance = pair.error_probability(stated)
    assert chance is not None
    assert 0.05 < chance < 0.4
    frame = simulated.simulate(ROBOT, Carried(motion), hidden=[DRAG], repeats=1, samples_per_period=SAMPLES)
    clean = NOISE.whitened(frame[list(ROBOT.channels)].to_numpy(), PERIOD / SAMPLES).ravel()
    truth, rival = rival_models(
        replace(spatial(six_axes()), convention=Convention.ON_SENSOR) + effects.viscous_drag(),
        effects.viscous_drag(),
        effects.quadratic_drag(),
    )
    view, rng = [plan.setting.view(motion)], np.random.default_rng(1)
    pair_fitted = DirectedPair(Hypothesis.of(truth, SIZES), rival)
    near = pair_fitted.rival_fit(view, plan.setting.reach).theta
    excess = np.empty(draws)
    for draw in range(draws):
        readings = clean + rng.standard_normal(len(clean))
        right = fit_rival(RivalAlongTrajectories(readings, truth.unrestricted, view), [pair_fitted.truth.theta])
        wrong = fit_rival(RivalAlongTrajectories(readings, rival.unrestricted, view), [near])
        excess[draw] = wrong.noncentrality - right.noncentrality
    low, high = (binom.ppf(tail, draws, chance) for tail in (0.5e-4, 1 - 0.5e-4))
    assert low <= (excess < 0).sum() <= high
    assert excess.mean() == pytest.approx(stated, abs=4 * 2 * np.sqrt(stated / draws))


@pytest.mark.long(4)
def test_designed_motion_confuses_less_than_the_d_optimal_one() -> None:
    """Twice lambda, as of any seed tried (1.8 to 3): the D-optimal one is where the search begins."""
    plan = told_apart()
    (pair,) = plan.pairs
    assert pair.exciting is not None
    assert pair.after > 1.5 * pair.exciting
    assert f"would need {pair.after / pair.exciting:.3g} times the runs" in str(plan)
    assert "error D-optimal" in str(plan)
    assert plan.to_data()["pairs"][0]["chance_exciting"] == pair.error_probability(pair.exciting)
