"""An arm within limits, and objectives of every kind, for tests of the optimiser."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from design.criteria import AOptimal, BayesianCriterion, Criterion, DOptimal, EOptimal, Subset
from design.information import Experiment, noise_equivalent_sizes
from design.optimiser.design_task import DesignTask
from design.optimiser.objective import Objective
from design.trajectories.fourier import FreeSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import TrajectorySeries
from modeling.chain.model import planar
from modeling.effects import com_offset, sensor_lag, viscous_drag
from modeling.noise import NoiseModel
from modeling.rig import Limits
from tests.shared.rigs import ARM

LIMITS = Limits(
    position=np.array([[-1.05, 1.05], [-1.2, 1.0], [-0.4, 1.4]]),  # asymmetric on purpose
    velocity=np.array([[-2.0, 2.0], [-2.2, 1.8], [-3.5, 3.5]]),
    acceleration=np.array([[-10.0, 10.0], [-10.0, 8.0], [-15.0, 15.0]]),
)
FREE = FreeSeries(joints=3, harmonics=(1, 2, 3, 4), period=5.0)
BASE = Experiment.of(planar(), ARM)
THETA = {"m": 1.6, "mlg": 0.2, "I": 0.05, "sensor_lag.tau": 0.02, "viscous_drag.c": 0.3, "viscous_drag.d": 0.2}


def objective(
    series: TrajectorySeries = FREE,
    criterion: Criterion | None = None,
    experiment: Experiment = BASE,
    samples: int = 60,
) -> Objective:
    return Objective(experiment=experiment, criterion=criterion or DOptimal(), series=series, samples=samples)


def task(series: TrajectorySeries = FREE, **others: object) -> DesignTask:
    return DesignTask(objective=objective(series), limits=LIMITS, arm=ARM, **others)  # type: ignore[arg-type]


def of_model(*ids: str) -> Experiment:
    effects = {"sensor_lag": sensor_lag(), "viscous_drag": viscous_drag(), "com_offset": com_offset()}
    model = planar() + [effects[i] for i in ids]
    return Experiment.of(model, ARM, {p.name: THETA.get(p.name, p.nominal) for p in model.parameters})


def cases() -> dict[str, Objective]:
    scale = noise_equivalent_sizes(BASE)
    sets = [{"viscous_drag.c": c, "viscous_drag.d": 0.2} for c in (0.1, 0.5)]
    return {
        "D": objective(),
        "A": objective(criterion=AOptimal(scale)),
        "E": objective(criterion=EOptimal(scale, power=2)),
        "Ds": objective(criterion=Subset((3, 4))),
        "spline": objective(SplineSeries(joints=3, knots=12, degree=3, period=5.0)),
        "rest": objective(RestToRest(inner=FREE, ramp=0.5)),
        "weighted": objective(experiment=replace(BASE, noise=NoiseModel.white([0.8, 1.6, 0.1]))),
        "drag": objective(experiment=of_model("viscous_drag", "com_offset")),
        "prior": objective(
            experiment=Experiment.prior(planar() + viscous_drag(), ARM, sets),
            criterion=BayesianCriterion(DOptimal(), (0.5, 0.5)),
        ),
    }


CASES = cases()


def functions(of: Objective) -> tuple[ca.Function, ca.Function, ca.Function]:
    """The criterion, its gradient, and its exact Hessian where there is one."""
    z = ca.MX.sym("z", of.series.size)
    graph = of.graph(z)
    second = [ca.hessian(graph, z)[0]] if of.exact else []
    return (
        ca.Function("f", [z], [graph]),
        ca.Function("g", [z], [ca.gradient(graph, z)]),
        ca.Function("h", [z], second),
    )
