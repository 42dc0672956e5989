"""Designs of six and seven axes beside what a user would take instead: `python -m benchmarks.design_six_axes RIG.toml`.

All maximise ln det(Phi'Phi) of the tool's 16 parameters over 200 samples of one period, by the same Fourier series,
within the same limits of the joints and of the tip's height, in as much processor time as ours took (of `--seeds N`
designs one after the other):

plain script    what one writes in an afternoon: one sample's columns as CasADi SX by the recursion of rigid bodies
                along the arm, mapped over the samples, ln det by Cholesky, limits at the samples, IPOPT with a
                limited-memory Hessian, from random starts
nevergrad CMA   an evolution strategy, with a penalty for broken limits
Nelder-Mead     SciPy's, with the same penalty

The last two are tuned as in `benchmarks.design_race`. Ours keeps the limits at every instant. The motions of the others
break them a little between the samples: `found` is their ln det as it is, with their largest use of a limit, and
`ln det` that of the same motion contracted into its limits, as ours are, which takes none of their time. The picture
shows the best contracted motion by then.

Deriving our columns, which the last two evaluate too, is outside the clock; building functions is on it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from time import process_time
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks import our_design
from benchmarks.race_plot import race_figure
from benchmarks.rivals import evolution, nelder_mead
from benchmarks.rivals.objective import Objective
from benchmarks.rivals.trace import OutOfTimeError, Recorder, Trace, one_after_the_other
from design.criteria import DOptimal
from design.information import Experiment
from design.information.experiment import gram
from design.limits import workspace_sides
from design.optimiser.design_task import DesignTask, contracted_into_limits
from design.optimiser.objective import Objective as DesignObjective
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory
from design.trajectory_design import DEFAULT_SAMPLES
from modeling.chain.model import spatial
from modeling.errors import InputError
from modeling.kinematics.arm import SpatialArm
from modeling.kinematics.placement import JointKind, Placement
from modeling.rig import Rig

Array = NDArray[np.float64]
START_SIZE = 0.1
"""rad: std of a start's coefficients about the middle of the limits."""
EVALUATIONS = 10**9
"""Of a search that ends by its time."""
CONTRACTED = 40
"""Motions of a search that are contracted: the latest ones at so many times, equally spaced in their logarithm."""
EARLIEST = 0.1
"""s: the first of these times."""
DRAWN = 40.0
"""Nats below our best that are drawn."""


def rotation(placement: Placement) -> Any:
    """(3, 3) of its quaternion."""
    x, y, z, w = placement.quaternion
    across = ca.skew(ca.DM([x, y, z]))
    return ca.DM.eye(3) + 2 * w * across + 2 * across @ across


def sample(arm: SpatialArm, gravity: float, tip_length: float) -> tuple[Any, Any]:
    """CasADi functions of a state (3n,): Phi'Phi (256,); and of q (n,): the tip's height, m."""
    n = arm.joints
    state = ca.SX.sym("x", 3 * n)
    q, dq, ddq = ca.vertsplit(state, n)
    spin, bend, push = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX([0, 0, gravity])
    place, turned = ca.SX.zeros(3), ca.SX.eye(3)
    for j, joint in enumerate([*arm.chain, None]):
        at = arm.sensor if joint is None else joint.placement
        lever, turn = ca.DM(at.position), rotation(at)
        push += ca.cross(bend, lever) + ca.cross(spin, ca.cross(spin, lever))
        place += turned @ lever
        if joint is not None:
            if joint.kind is JointKind.PRISMATIC:
                raise InputError(what="it has a prismatic joint", where="arm", remedy="take one of revolute joints")
            across = ca.skew(ca.DM(joint.axis))
            turn = turn @ (ca.SX.eye(3) + ca.sin(q[j]) * across + (1 - ca.cos(q[j])) * (across @ across))
        spin, bend, push, turned = turn.T @ spin, turn.T @ bend, turn.T @ push, turned @ turn
        if joint is not None:
            along = ca.DM(joint.axis)
            bend += ca.cross(spin, along * dq[j]) + along * ddq[j]
            spin += along * dq[j]

    def inertia(v: Any) -> Any:
        """The matrix of J v over Jxx, Jxy, Jxz, Jyy, Jyz, Jzz."""
        x, y, z = ca.vertsplit(v)
        return ca.blockcat([[x, y, z, 0, 0, 0], [0, x, 0, y, z, 0], [0, 0, x, 0, y, z]])

    force = ca.horzcat(push, ca.skew(bend) + ca.skew(spin) @ ca.skew(spin), ca.SX.zeros(3, 6))
    torque = ca.horzcat(ca.SX.zeros(3, 1), -ca.skew(push), inertia(bend) + ca.skew(spin) @ inertia(spin))
    phi = ca.horzcat(ca.SX.eye(6), ca.vertcat(force, torque))
    height = (place + turned @ ca.DM([0, 0, tip_length]))[2]
    return ca.Function("phi", [state], [ca.vec(phi.T @ phi)]), ca.Function("height", [q], [height])


def plain(rig: Rig, series: FreeSeries, seconds: float) -> tuple[list[float], list[Trajectory]]:
    """The processor time until the end of each start, as many as begin within the time, and their motions."""
    arm, limits = rig.arm, rig.limits
    if not isinstance(arm, SpatialArm) or limits is None:
        raise InputError(what="an arm of a URDF and limits were expected", where="rig", remedy="give such a rig")
    begun, instants = process_time(), series.instants(DEFAULT_SAMPLES)
    each, height = sample(arm, rig.gravity, rig.tip_length or 0.0)
    z, matrix = ca.MX.sym("z", series.size), ca.SX.sym("M", 16, 16)
    logdet = ca.Function("logdet", [matrix], [2 * ca.sum1(ca.log(ca.diag(ca.chol(matrix))))])
    rows, low, high, states = list[Any](), list[Array](), list[Array](), list[Any]()
    for order, pairs in enumerate((limits.position, limits.velocity, limits.acceleration)):
        basis = ca.sparsify(ca.DM(series.basis(instants, order).reshape(-1, series.size)))
        states.append(ca.reshape(basis @ z, series.joints, len(instants)))
        rows.append(ca.vec(states[-1]))
        low.append(np.tile(pairs[:, 0], len(instants)))
        high.append(np.tile(pairs[:, 1], len(instants)))
    if rig.workspace is not None and rig.workspace.z is not None:
        rows.append(height.map(len(instants))(states[0]).T)
        low.append(np.full(len(instants), rig.workspace.z[0]))
        high.append(np.full(len(instants), rig.workspace.z[1]))
    information = ca.reshape(ca.sum2(each.map(len(instants))(ca.vertcat(*states))), 16, 16)
    options = {"print_level": 0, "sb": "yes", "hessian_approximation": "limited-memory", "max_iter": 300, "tol": 1e-4}
    program = {"x": z, "f": -logdet(information), "g": ca.vertcat(*rows)}
    quiet: dict[str, Any] = {f"ipopt.{name}": value for name, value in options.items()} | {"print_time": False}
    solver = ca.nlpsol("plain", "ipopt", program, quiet)
    ends, motions, rng = list[float](), list[Trajectory](), np.random.default_rng(0)
    middle = limits.position.mean(axis=1)
    while not ends or process_time() - begun < seconds:
        start = series.rest(middle) + START_SIZE * rng.standard_normal(series.size)
        solution = solver(x0=start, lbg=np.concatenate(low), ubg=np.concatenate(high))
        motions.append(Trajectory(series, np.array(solution["x"]).ravel()))
        ends.append(process_time() - begun)
    return ends, motions


@dataclass(frozen=True, eq=False, kw_only=True)
class ArmObjective(Objective):
    """What the searches with a penalty get: of the tool of an arm of six or seven axes, and of its tip's height too."""

    task: DesignTask

    def information(self, states: Array) -> Array:
        """Phi'Phi (B, k, k) of states (3 n, N, B)."""
        experiment, duration = self.task.objective.experiment, self.series.duration
        motions = np.moveaxis(states.reshape(3, self.series.joints, *states.shape[1:]), (3, 0), (0, 1))
        columns = (experiment.columns(q.T, dq.T, ddq.T, duration) for q, dq, ddq in motions)
        return np.array([gram(each) for each in columns])

    def other_uses(self, states: Array) -> Array:
        """(R, B): of the tip's coordinates that are limited."""
        q = states[: self.series.joints].reshape(self.series.joints, -1)
        sides = workspace_sides(self.task.workspace, self.task.arm).values()
        places = self.tip(q) if sides else q
        rows = [(places[i] - (low + high) / 2) / ((high - low) / 2) for i, (low, high) in sides]
        return np.reshape(rows, (-1, states.shape[2])) if rows else super().other_uses(states)

    @cached_property
    def tip(self) -> Callable[[Array], Array]:
        """The tip's coordinates (3, N) at positions (n, N)."""
        if self.task.arm is None:
            raise InputError(what="no arm was given", where="rig", remedy="give one of a URDF")
        function = self.task.arm.tip(self.task.tip_length or 0.0)
        return lambda q: np.array(function(q))


@dataclass(frozen=True, eq=False)
class Entrant:
    """What one found: `trace` of the motions contracted into their limits, `last` the last of them before that."""

    trace: Trace
    last: Trajectory | None

    @classmethod
    def of(cls, task: DesignTask, trace: Trace, motions: Sequence[Trajectory]) -> Entrant:
        """From a trace with the motion of each of its improvements."""
        steps = np.geomspace(EARLIEST, max(trace.total_seconds, 2 * EARLIEST), CONTRACTED)
        latest = np.unique(np.searchsorted(trace.seconds, steps, side="right") - 1)
        kept, values, best = list[int](), list[float](), -np.inf
        for number in latest[latest >= 0]:
            inside = contracted_into_limits(task, motions[number])
            value = -np.inf if inside is None else task.objective.value(inside.coefficients)
            if value > best:
                kept, values, best = [*kept, int(number)], [*values, value], value
        seconds, evaluations = trace.seconds[kept], trace.evaluations[kept]
        contracted = replace(trace, seconds=seconds, evaluations=evaluations, logdet=np.array(values))
        return cls(contracted, motions[kept[-1]] if kept else None)

    def line(self, task: DesignTask) -> str:
        """A row of the table."""
        if self.last is None:
            return f"{self.trace.name:<15}{'none':>10}{'':>20}{self.trace.total_seconds:>10.1f}"
        value, use = task.objective.value(self.last.coefficients), task.use(self.last).worst.use
        figures = f"{self.trace.best:>10.3f}{value:>10.3f}{use:>10.4f}{self.trace.total_seconds:>10.1f}"
        return f"{self.trace.name:<15}{figures}{self.trace.total_evaluations:>12}"


def scripted(task: DesignTask, rig: Rig, series: FreeSeries, seconds: float) -> Entrant:
    """The plain script's starts; each counts as an evaluation."""
    ends, motions = plain(rig, series, seconds)
    values = np.array([task.objective.value(motion.coefficients) for motion in motions])
    trace = Trace(
        name="plain script",
        seconds=np.array(ends),
        evaluations=np.arange(1.0, len(ends) + 1),
        logdet=values,
        motion=None,
        total_seconds=ends[-1],
        total_evaluations=len(ends),
    )
    return Entrant.of(task, trace, motions)


def penalised(task: DesignTask, search: Callable[[Recorder, int, int], None], name: str, seconds: float) -> Entrant:
    """A search with a penalty, ended by its time."""
    objective = ArmObjective(task.objective.series, task.limits, task=task)
    recorder = Recorder(objective, name, seconds)
    with suppress(OutOfTimeError):
        search(recorder, 0, EVALUATIONS)
    return Entrant.of(task, recorder.trace(), [objective.motion(x) for x in recorder.improvements])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what each reached in the same processor time, and draw it."""
    parser = argparse.ArgumentParser(description="designs of six axes against what a user would take instead")
    parser.add_argument("rig", type=Path)
    parser.add_argument("--harmonics", type=int, default=5)
    parser.add_argument("--period", type=float, default=10.0)
    parser.add_argument("--seeds", type=int, default=1, help="designs of ours, one after the other (default: 1)")
    parser.add_argument("--plot", type=Path, help="where to write the picture, e.g. six_axes.png")
    asked = parser.parse_args(arguments)
    rig = Rig.read(asked.rig)
    if rig.arm is None or rig.limits is None:
        raise InputError(what="an arm and its limits were expected", where=str(asked.rig), remedy="give such a rig")
    series = FreeSeries(joints=rig.arm.joints, harmonics=tuple(range(1, asked.harmonics + 1)), period=asked.period)
    experiment = Experiment.of(spatial(rig), rig.arm)
    task = DesignTask(
        objective=DesignObjective(experiment=experiment, criterion=DOptimal(), series=series, samples=DEFAULT_SAMPLES),
        limits=rig.limits,
        arm=rig.arm,
        workspace=rig.workspace,
        tip_length=rig.tip_length,
    )
    seeds = range(asked.seeds)
    traced = one_after_the_other([our_design.traced(seed, rig=rig, series=series) for seed in seeds])
    heads = f"{'ln det':>10}{'found':>10}{'use':>10}{'CPU s':>10}{'evaluations':>12}"
    print(f"{'':<15}{heads}", Entrant(traced, traced.motion).line(task), sep="\n", flush=True)
    entrants = [scripted(task, rig, series, traced.total_seconds)]
    print(entrants[-1].line(task), flush=True)
    searches = {"nevergrad CMA": evolution.evolved, "Nelder-Mead": nelder_mead.restarted}
    for name, search in searches.items():
        entrants.append(penalised(task, search, name, traced.total_seconds))
        print(entrants[-1].line(task), flush=True)
    if asked.plot is not None:
        race = {each.trace.name: each.trace for each in [Entrant(traced, traced.motion), *entrants]}
        figure = race_figure([race], problem=asked.rig.stem, worst=traced.best - DRAWN)
        figure.savefig(asked.plot, dpi=200, facecolor="white")


if __name__ == "__main__":
    main()
