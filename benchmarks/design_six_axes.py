"""Designs of six and seven axes against a plain script with IPOPT: `python -m benchmarks.design_six_axes RIG.toml`.

Both maximise ln det(Phi'Phi) of the tool's 16 parameters over 200 samples of one period, by the same Fourier series,
within the same limits of the joints and of the tip's height. The script is what one writes in an afternoon: one
sample's columns as CasADi SX by the recursion of rigid bodies along the arm, mapped over the samples, ln det by
Cholesky, limits at the samples, IPOPT with a limited-memory Hessian, from random starts as long as ours took. Ours
keeps the limits at every instant; the script's motion is shown as it is, with its largest use of a limit between the
samples.

Processor time of one process, start-up and building the functions included for both.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from time import process_time
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from design.limits import LimitUse
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory
from design.trajectory_design import DEFAULT_SAMPLES, design
from modeling.errors import InputError
from modeling.kinematics.arm import SpatialArm
from modeling.kinematics.placement import JointKind, Placement
from modeling.rig import Rig

Array = NDArray[np.float64]
START_SIZE = 0.1
"""rad: std of a start's coefficients about the middle of the limits."""


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


def plain(rig: Rig, series: FreeSeries, seconds: float) -> list[tuple[float, float, Trajectory]]:
    """ln det and the processor time until then of each start, as many as fit into the time."""
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
    found, rng, middle = list[tuple[float, float, Trajectory]](), np.random.default_rng(0), limits.position.mean(axis=1)
    while not found or process_time() - begun < seconds:
        start = series.rest(middle) + START_SIZE * rng.standard_normal(series.size)
        solution = solver(x0=start, lbg=np.concatenate(low), ubg=np.concatenate(high))
        motion = Trajectory(series, np.array(solution["x"]).ravel())
        found.append((-float(solution["f"]), process_time() - begun, motion))
    return found


def line(name: str, logdet: float, use: float, seconds: float, starts: int) -> str:
    """A row of the table."""
    return f"{name:<12}{logdet:>10.3f}{use:>10.4f}{seconds:>10.1f}{starts:>8}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print ln det, the largest use of a limit at any instant, processor seconds and starts of both."""
    parser = argparse.ArgumentParser(description="designs of six axes against a plain script")
    parser.add_argument("rig", type=Path)
    parser.add_argument("--harmonics", type=int, default=5)
    parser.add_argument("--period", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    rig = Rig.read(asked.rig)
    if rig.arm is None or rig.limits is None:
        raise InputError(what="an arm and its limits were expected", where=str(asked.rig), remedy="give such a rig")
    series = FreeSeries(joints=rig.arm.joints, harmonics=tuple(range(1, asked.harmonics + 1)), period=asked.period)
    begun = process_time()
    ours = design(rig, series=series, seed=asked.seed, bounded=False)
    seconds = process_time() - begun
    print(f"{'':<12}{'ln det':>10}{'use':>10}{'CPU s':>10}{'starts':>8}")
    print(line("truewrench", ours.logdet, ours.limit_use.worst.use, seconds, 6), flush=True)
    found = plain(rig, series, seconds)
    best, _, motion = max(found, key=lambda attempt: attempt[0])
    use = LimitUse.of(motion, rig.limits, rig.workspace, rig.arm, rig.tip_length).worst.use
    print(line("plain script", best, use, found[-1][1], len(found)))


if __name__ == "__main__":
    main()
