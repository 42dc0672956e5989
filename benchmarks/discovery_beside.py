"""Discovery beside what a user would reach for: Operon and PySINDy on the residual of the rigid tool, the same data.

`pip install pyoperon pysindy`, then `python -m benchmarks.discovery_beside [--draws N] [--power P] [--noise NAME]`

Each library gets the averaged residual of the channel that has most of it, standardised, and as columns the motion of
the sensor: they know neither units nor frames nor repeats. All are asked what they explain of the other motion, nothing
fitted there. An equation of nothing hidden is a false one.

fitted   share of the residual's power on the fitted motion, R²; most of it is noise
other    the same on the motion held out
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.discovery import Trial, model_and_rig
from benchmarks.discovery_forms import FORMS
from diagnosis.discovery.discovery import discover, without_terms
from estimation.fit import Fit, fit
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.simulated_rig import NOISE_MODELS

Array = NDArray[np.float64]
Regression = Callable[[Array, Array], tuple[Callable[[Array], Array], int]]
"""Of columns (n, k) and a target (n,): a prediction of other columns, and the number of its terms."""


def sparse(columns: Array, target: Array) -> tuple[Callable[[Array], Array], int]:
    """PySINDy's sequentially thresholded least squares over polynomials of the second order."""
    from pysindy import STLSQ, PolynomialLibrary

    library = PolynomialLibrary(degree=2)
    features = np.asarray(library.fit_transform(columns))
    optimizer = STLSQ(threshold=0.1, alpha=0.05).fit(features, target[:, None])
    weights = np.asarray(optimizer.coef_).ravel()
    return lambda others: np.asarray(library.transform(others)) @ weights, int((weights != 0).sum())


def evolved(columns: Array, target: Array) -> tuple[Callable[[Array], Array], int]:
    """Operon's genetic programming with local search, its model by description length."""
    from pyoperon.sklearn import SymbolicRegressor

    symbols = "add,sub,mul,div,sin,sqrt,abs,square,constant,variable"
    regressor = SymbolicRegressor(
        allowed_symbols=symbols, max_length=25, optimizer_iterations=3, max_time=20, n_threads=1, random_state=0
    )
    regressor.fit(columns, target)
    return lambda others: np.asarray(regressor.predict(others)), int(regressor.model_.Length)


def residual_and_columns(fitted: Fit) -> tuple[Array, Array]:
    """The averaged residual (n, p) in units of the noise, and the motion's columns (n, k) that change."""
    (recording,) = fitted.recordings
    samples = recording.samples_per_repeat
    residual = recording.averaged(fitted.residuals[0])[:samples] / fitted.noise_floor(0)
    signals = recording.motion.model_signals
    left_out = ("time", "order", "progress", *recording.auxiliary)
    names = sorted(n for n in signals if n not in left_out and np.ptp(signals[n]) > 1e-9)
    return residual, np.column_stack([signals[name][:samples] for name in names])


def r_squared(target: Array, predicted: Array) -> float:
    """Share of the power that is predicted."""
    return float(1 - ((target - predicted) ** 2).sum() / (target**2).sum())


def rows_of(trial: Trial) -> list[tuple[str | float | None, ...]]:
    """One of each library, and of discovery."""
    (training, other), _ = trial.recordings()
    model, hidden = model_and_rig(trial.space)[0], trial.form or "nothing"
    found = discover(model, training, validate=other)
    residuals, columns = zip(*(residual_and_columns(fit(model, r)) for r in (training, other)), strict=True)
    channel = int(np.argmax((residuals[0] ** 2).sum(axis=0)))
    scale = residuals[0][:, channel].std()
    targets = [residual[:, channel] / scale for residual in residuals]
    afterwards = fit(model, without_terms(other, found.first, found.last))
    left = [residual_and_columns(fitted)[0][:, channel] / scale for fitted in (found.last, afterwards)]
    ours = [r_squared(target, target - rest) for target, rest in zip(targets, left, strict=True)]
    said = "; ".join(equation.formula for equation in found.equations) or "none"
    rows: list[tuple[str | float | None, ...]] = [(hidden, "discover", said, *(ours if found.found else (None, None)))]
    centre, size = columns[0].mean(axis=0), np.maximum(columns[0].std(axis=0), 1e-12)
    inputs = [(each - centre) / size for each in columns]
    for name, regression in (("PySINDy", sparse), ("Operon", evolved)):
        predict, terms = regression(inputs[0], targets[0])
        shares = [r_squared(target, predict(each)) for target, each in zip(targets, inputs, strict=True)]
        rows.append((hidden, name, f"{terms} {'terms' if name == 'PySINDy' else 'nodes'}", *shares))
    return rows


def main() -> None:
    """Run all and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--forms", nargs="*", default=["cubic drag", "Magnus", "magnet", "rate squared"], choices=FORMS)
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--power", type=float, default=200.0)
    parser.add_argument("--noise", default="white", choices=list(NOISE_MODELS))
    options = parser.parse_args()
    trials = [
        Trial(form, Space.PLANE, options.power, options.noise, 4, seed)
        for form in (*options.forms, None)
        for seed in range(options.draws)
    ]
    columns = ("hidden", "by", "said", Column("fitted", format=".2f"), Column("other", format=".2f"))
    print(Table.of(columns, [row for trial in trials for row in rows_of(trial)]))


if __name__ == "__main__":
    main()
