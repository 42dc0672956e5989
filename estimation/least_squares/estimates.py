"""Estimated parameters with std and unit, and their unidentifiable combinations."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.levenberg_marquardt import NEGLIGIBLE_COLUMN_LENGTH
from estimation.least_squares.square_root_information import SquareRootInformation
from modeling.errors import InputError, quoted, suggestion
from modeling.identifiability import (
    MOST_LISTED,
    LeastCertainDirection,
    ScaledSVD,
    UnidentifiableDirection,
    least_certain_direction,
    open_combinations,
    unidentifiable_directions,
)
from modeling.number_format import NOT_IDENTIFIABLE, digits_of
from modeling.parameter import Parameter, Role
from modeling.rig import Convention
from modeling.table import Cell, Column, Table, Tabular, Value

if TYPE_CHECKING:
    import pandas as pd

    from modeling.chain.model import WrenchModel

Array = NDArray[np.float64]

FAMILIAR_NAMES = {
    "redchi": "reduced_chi_square",
    "chisqr": "reduced_chi_square, per degree of freedom",
    "chi2": "reduced_chi_square, per degree of freedom",
    "covar": "covariance",
    "pcov": "covariance",
    "cov_params": "covariance",
    "correl": "correlation",
    "popt": "theta",
    "coef_": "values",
    "best_values": "values",
    "stderr": 'params["std"], or fit["m"].std of one parameter',
    "bse": 'params["std"], or fit["m"].std of one parameter',
    "std": 'params["std"], or fit["m"].std of one parameter',
    "best_fit": "predict()",
    "fittedvalues": "predict()",
    "residual": "residuals, of each recording",
    "resid": "residuals, of each recording",
    "conf_int": 'intervals(), and params[["low", "high"]]',
    "ci_report": "intervals()",
    "fit_report": "summary()",
    "success": "converged",
}
"""What holds here an attribute of fits of lmfit, SciPy, scikit-learn or statsmodels, by its name there."""


def unknown_attribute(kind: str, name: str) -> str:
    """Message for an attribute that a class `kind` has not."""
    missing = f"a {kind} has no attribute '{name}'"
    return f"{missing}; see {FAMILIAR_NAMES[name]}" if name in FAMILIAR_NAMES else missing


FIXED, HELD = "fixed", "held at its bound"
"""Printed for the std of a parameter that is not free, and of one that a bound holds."""
NOT_CONVERGED = "not converged: the estimates are not final"
"""Said wherever estimates of an iteration that ended before a minimum are shown."""
ONE_NUMBER = (
    "the scale of the sensor and the mass of its tool are one number in these recordings: record a motion again with"
    " known loads and state them (--load REC=MASS@X,Y,Z; loads= in Python)"
)
"""Said where a model has the gain of every channel and nothing weighed tells it from the tool."""
ILL_CONDITIONED = 1e3
"""Condition number above which a table remarks on it: one direction is a thousand times less certain than another."""


@dataclass(frozen=True)
class Estimate:
    """One estimated parameter: value and standard deviation in `unit`.

    `resolution` is what its readings are apart, of an onset the sampling step: no finer is it printed.
    """

    name: str
    value: float
    std: float
    unit: str
    resolution: float = 0.0

    @property
    def shown_std(self) -> float:
        """The std that it is printed with, not below the resolution; zero where it is fixed."""
        return max(self.std, self.resolution) if self.std > 0 else self.std

    @property
    def known(self) -> float | None:
        """The value; None where the parameter is not identifiable."""
        return self.value if np.isfinite(self.std) else None


PARAMETER_COLUMNS = (
    Column("parameter"),
    Column("value", format=".6g"),
    Column("std", format=".2g", unknown=NOT_IDENTIFIABLE),
    Column("unit"),
)


def fixed_parameters(parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    """Which of the parameters (k,) are fixed."""
    return np.array([p.fixed for p in parameters])


@runtime_checkable
class EstimatedModel(Protocol):
    """A model with its parameters estimated: the face of a fit, of a streamed fit and of a model file."""

    @property
    def model(self) -> WrenchModel:
        """The model."""

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """Every parameter by name, with std and unit; of a fit the biases of further recordings after the model's."""

    @property
    def theta(self) -> Array:
        """Their values (k,), in that order."""

    @property
    def covariance(self) -> Array:
        """Their covariance (k, k)."""

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """Which of them (k,) are identifiable."""


class NamedEstimates:
    """Estimates by parameter name, as `fit["m"]`; iteration, `in` and `len` are over the names, as of a mapping."""

    def __getitem__(self: EstimatedModel, name: str) -> Estimate:
        """The estimate of that full name; InputError, with what was meant, for none.

        `mlx` is not `com_offset.mlx`: the short name is ambiguous as soon as another effect has such a parameter.
        """
        if name not in self.parameters:
            remedy = suggestion(str(name), self.parameters)
            raise InputError(what=f"no parameter is called {quoted(name)}", where="fit", remedy=remedy)
        return self.parameters[name]

    def __iter__(self: EstimatedModel) -> Iterator[str]:
        return iter(self.parameters)

    def __contains__(self: EstimatedModel, name: object) -> bool:
        return name in self.parameters

    def __len__(self: EstimatedModel) -> int:
        return len(self.parameters)

    @property
    def values(self: EstimatedModel) -> dict[str, float]:
        """The value of every parameter by name."""
        return {name: estimate.value for name, estimate in self.parameters.items()}


class Estimates(NamedEstimates, Tabular):
    """Parameters estimated by least squares, from recordings or a stream.

    theta        (k,), its covariance (k, k), and `identifiable` (k,), whether a parameter is identifiable
    converged    whether the iteration converged
    """

    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]
    converged: bool
    onset_resolution: float = 0.0
    """Of onsets, s: the sampling step, where it is one."""

    if TYPE_CHECKING:

        @property
        def model(self) -> WrenchModel:
            """The model, a field of some and a property of others."""

    @cached_property
    @abstractmethod
    def information(self) -> SquareRootInformation:
        """Square-root information of theta from the whitened rows."""

    @property
    @abstractmethod
    def unknowns(self) -> tuple[Parameter, ...]:
        """The estimated parameters, in the order of theta."""

    @cached_property
    def parameters(self) -> Mapping[str, Estimate]:
        """Every parameter by name, with std and unit; an unidentifiable one has an infinite std, a fixed one none."""
        std = np.where(self.identifiable, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)
        std[fixed_parameters(self.unknowns)] = 0.0
        return {
            p.name: Estimate(
                p.name, float(value), float(s), p.unit, self.onset_resolution if p.role is Role.ONSET else 0.0
            )
            for p, value, s in zip(self.unknowns, self.theta, std, strict=True)
        }

    @property
    def params(self) -> pd.DataFrame:
        """Value, std and unit of every parameter, by name, as a data frame."""
        return parameter_frame(self.parameters)

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlation coefficients (k, k) of the estimates; missing for an unidentifiable parameter."""
        return correlation_frame(list(self.parameters), self.covariance, self.identifiable)

    @cached_property
    def scaled_svd(self) -> ScaledSVD:
        """Scaled SVD of the information: its identifiable directions."""
        return ScaledSVD.of(self.information.root, faint=NEGLIGIBLE_COLUMN_LENGTH)

    @property
    def condition(self) -> float:
        """Condition number of the whitened columns scaled to unit norm, over the identifiable directions."""
        return self.scaled_svd.condition

    @cached_property
    def unidentifiable(self) -> tuple[UnidentifiableDirection, ...]:
        """Unidentifiable parameter combinations, of parameters that are not fixed, and of onsets of unknown std.

        An onset whose std is known has no derivative, as its edge is between two samples.
        """
        directions = unidentifiable_directions(self.scaled_svd, self.unknowns)
        known = {p.name for p, is_known in zip(self.unknowns, self.identifiable, strict=True) if is_known}
        onsets = {p.name for p in self.unknowns if p.role is Role.ONSET and p.name in known}
        return tuple(d for d in directions if not any(p.fixed for p in d.parameters) and not onsets.issuperset(d.names))

    @cached_property
    def weakest(self) -> LeastCertainDirection | None:
        """The least certain of the identifiable directions."""
        return least_certain_direction(self.scaled_svd, self.unknowns)

    @property
    def table(self) -> Table:
        """Name, value, std and unit of every parameter; of one that is fixed or held at a bound this, for its std."""
        return parameter_table(self.parameters, self.held)

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the parameters that a bound holds: their std is not that of a measurement."""
        ends = zip(self.unknowns, self.theta, self.identifiable, strict=True)
        return tuple(p.name for p, value, is_known in ends if is_known and not p.fixed and value in p.bounds)

    def remarks(self) -> list[str]:
        """Remarks on the estimate: ill-conditioning, unidentifiable combinations, missing convergence."""
        remarks = [f"condition {self.condition:.2g}; {self.weakest}"] if self.condition > ILL_CONDITIONED else []
        alone = [d.names[0] for d in self.unidentifiable if len(d.names) == 1]
        if len(alone) > 1:
            remarks.append(f"{', '.join(alone[:-1])} and {alone[-1]} are not identifiable from this motion")
        scaling = {effect.id for effect in self.model.effects if effect.scales_mass}
        if any("m" in d.names and scaling & {n.partition(".")[0] for n in d.names} for d in self.unidentifiable):
            remarks.append(ONE_NUMBER)
        several = [d for d in self.unidentifiable if len(d.names) > MOST_LISTED]
        remarks += [str(d) for d in self.unidentifiable if d not in several and (len(d.names) > 1 or len(alone) == 1)]
        remarks += [open_combinations(several)] if several else []
        return remarks if self.converged else [*remarks, NOT_CONVERGED]


def parameter_table(estimates: Mapping[str, Estimate], held: Collection[str] = ()) -> Table:
    """Name, value, std and unit by name; for the std of a fixed parameter, and one `held` at a bound, that it is."""
    rows = [
        (e.name, Cell(e.known, format=digits_of(e.value, e.shown_std)), _std_cell(e, held), e.unit)
        for e in estimates.values()
    ]
    return Table.of(PARAMETER_COLUMNS, rows)


def _std_cell(estimate: Estimate, held: Collection[str]) -> Value:
    if estimate.std == 0:
        return Cell(None, FIXED)
    return Cell(None, HELD) if estimate.name in held else estimate.std


def parameter_frame(estimates: Mapping[str, Estimate]) -> pd.DataFrame:
    """Value, std and unit by name."""
    import pandas as pd

    rows = [(e.value, e.std, e.unit) for e in estimates.values()]
    return pd.DataFrame(rows, columns=["value", "std", "unit"], index=pd.Index(estimates, name="parameter"))


def correlation_frame(names: Sequence[str], covariance: Array, identifiable: NDArray[np.bool_]) -> pd.DataFrame:
    """Correlation coefficients (k, k) by name; missing where a parameter is fixed or not identifiable."""
    import pandas as pd

    index = pd.Index(names, name="parameter")
    return pd.DataFrame(correlation_matrix(covariance, identifiable), index=index, columns=index)


def correlation_matrix(covariance: Array, identifiable: NDArray[np.bool_]) -> Array:
    """Correlation coefficients (k, k); NaN where a parameter is fixed or not identifiable."""
    variance = np.where(identifiable & np.isfinite(np.diag(covariance)), np.diag(covariance), 0.0)
    std = np.where(variance > 0, np.sqrt(np.maximum(variance, 0.0)), np.nan)
    correlation: Array = covariance / std / std[:, None]
    return correlation


def estimates_data(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """Parameter estimates by name as plain data."""
    return {name: {"value": e.value, "std": e.std, "unit": e.unit} for name, e in estimates.items()}


def require_positive_mass(mass: Estimate, stated: Convention, where: str) -> None:
    """Raise InputError when the mass is below -3 std: the readings have the sign convention opposite to the stated."""
    if mass.value >= -3 * mass.std:
        return
    other = Convention.ON_SENSOR if stated is Convention.ON_TOOL else Convention.ON_TOOL
    check = "check the axes of the readings, or whether the base hangs (gravity_direction under [robot])"
    net = "where a controller subtracts more than the tool weighs, --read payload_compensated"
    raise InputError(
        what=f"the mass comes out as {mass.value:.3g} ± {mass.std:.2g} kg with readings {stated.value}",
        where=where,
        remedy=f'state convention = "{other.value}" under [sensor] in the rig, or {check}; {net}',
    )
