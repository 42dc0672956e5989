"""Prior: a reference tool, from CAD or an earlier fit, with its weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Self

import numpy as np

from estimation.least_squares.constraints.log_det_divergence import LogDetDivergence
from estimation.least_squares.constraints.parameter_file import is_real_number, read_parameter_file, require_known_names
from modeling.chain.pseudo_inertia import PseudoInertia
from modeling.errors import InputError


@dataclass(frozen=True)
class Prior:
    """The moments of a reference tool, and the weight of its divergence in the chi-square.

    `read` takes them from a TOML file, `from_data` from a dictionary of its layout.

    Parameters
    ----------
    values : mapping of str to float
        Every moment of the reference tool by parameter name, in SI units: `m`, `mlg`, `I` in the plane.
    weight : float
        A precision: the reference counts like an independent measurement of each of the tool's principal moments with a
        relative standard deviation of sqrt(2 / weight): 200 for 10 %, 20 000 for 1 %; 0 disables it.
    where : str, optional
        Their source in an InputError, by default "prior".

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> model = tw.planar(rig) + tw.effects.named("viscous_drag")
    >>> prior = tw.Prior({"m": 0.9, "mlg": 0.063, "I": 0.0129}, weight=200)
    >>> found = tw.fit(model, tw.read("train.csv", rig=rig), constraints=tw.Constraints(prior=prior))
    >>> round(found.values["I"], 4)
    0.0129
    """

    values: Mapping[str, float]
    weight: float
    where: str = "prior"

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The prior of a TOML file: `weight = 200`, and the reference as `m = 0.9`, `mlg = 0.063`, `I = 0.0129`.

        Raises InputError, in one line with file and key, for a value that is not a finite number.
        """
        return cls.from_data(read_parameter_file(path), where=str(path))

    @classmethod
    def from_data(cls, data: Mapping[str, object], *, where: str = "prior") -> Self:
        """The prior of a plain dictionary with the file's layout."""
        numbers = {name: _number(name, value, where) for name, value in data.items()}
        if "weight" not in numbers:
            remedy = "add weight = 200 for a relative std of 10 % of the reference, 20000 for 1 %"
            raise InputError(what="weight is missing", where=where, remedy=remedy)
        weight = numbers.pop("weight")
        if weight < 0:
            raise InputError(what=f"weight: {weight:g} is negative", where=where, remedy="give 0 or more")
        return cls(numbers, weight, where)

    def divergence(self, inertia: PseudoInertia, names: Sequence[str]) -> LogDetDivergence:
        """The term that this prior adds to the chi-square, over all parameters `names`.

        Raises InputError when a moment of the tool is missing, a name is not a moment, or the moments are not
        physically consistent.
        """
        require_known_names(self.values, inertia.names, self.where)
        missing = [name for name in inertia.names if name not in self.values]
        if missing:
            remedy = "give every moment of the reference tool"
            raise InputError(what=f"{missing[0]} is missing", where=self.where, remedy=remedy)
        reference = inertia.at(np.array([self.values[name] for name in inertia.names]))
        scale = np.sqrt(np.maximum(np.abs(np.diag(reference)), 1e-300))
        if np.linalg.eigvalsh(reference / np.outer(scale, scale)).min() <= 0:
            what = f"no tool has these moments: {inertia.condition} does not hold strictly"
            raise InputError(
                what=what, where=self.where, remedy="give the moments of a tool with positive mass and extent"
            )
        return LogDetDivergence(inertia.over(names), reference, self.weight)


def _number(name: str, value: object, where: str) -> float:
    if not is_real_number(value) or not isfinite(float(value)):  # type: ignore[arg-type]
        remedy = "write name = value, in the parameter's SI unit"
        raise InputError(what=f"{name}: a number was expected, and {value!r:.60} came", where=where, remedy=remedy)
    return float(value)  # type: ignore[arg-type]
