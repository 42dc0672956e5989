"""Constraints of a fit: bounds, physical consistency of the tool, and a prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from estimation.least_squares.constraints.bounds import Bounds, Interval
from estimation.least_squares.constraints.feasible_region import FeasibleRegion
from estimation.least_squares.constraints.infeasible_subset import require_interior
from estimation.least_squares.constraints.parameter_file import require_known_names
from estimation.least_squares.constraints.prior import Prior
from estimation.parameter_layout import ParameterLayout
from modeling.chain.pseudo_inertia import pseudo_inertia
from modeling.errors import InputError, kind_of


@dataclass(frozen=True, kw_only=True)
class Constraints:
    """Bounds of parameters, physical consistency of the tool, and a reference tool as prior; each is optional.

    The fit raises InputError when a name is unknown, the tool's moments are not linear in the parameters, or the
    constraints are infeasible together (it names an irreducible subset).

    Parameters
    ----------
    bounds : Bounds, or mapping of str to (float, float) or float, optional
        Lower and upper bounds of parameters, a number of which fixes one; by default none.
    physical : bool, optional
        Whether the pseudo-inertia must be positive definite, by `CONSISTENCY_MARGIN` of the tool's own size: some mass
        distribution that is neither flat nor a line has these moments. By default not.
    prior : Prior, optional
        Reference tool; implies physical consistency where its weight is not 0. By default none.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> model = tw.planar(rig) + tw.effects.named("viscous_drag")
    >>> stated = tw.Constraints(bounds={"m": 0.89}, physical=True)
    >>> found = tw.fit(model, tw.read("train.csv", rig=rig), constraints=stated)
    >>> round(found.values["m"], 6), found.values["I"] > 0
    (0.89, True)
    """

    bounds: Bounds | Mapping[str, Interval] | None = None
    physical: bool = False
    prior: Prior | None = None

    def __post_init__(self) -> None:
        _ = self._bounds

    @classmethod
    def of(cls, given: StatedConstraints) -> Constraints:
        """The constraints of an argument that has bounds alone, too; InputError, in a sentence, for anything else."""
        other: object = given  # whatever the caller's types say
        if isinstance(other, Constraints):
            return other
        if isinstance(other, Bounds | Mapping):
            return cls(bounds=other)
        what = f"{kind_of(other)} is no set of constraints"
        remedy = 'give bounds by parameter, {"m": (0.1, 3.0)}, or tw.Constraints(bounds=.., physical=.., prior=..)'
        raise InputError(what=what, where="constraints", remedy=remedy)

    @property
    def _bounds(self) -> Bounds:
        given = {} if self.bounds is None else self.bounds
        return given if isinstance(given, Bounds) else Bounds(given)

    def region(self, unknowns: ParameterLayout) -> FeasibleRegion:
        """Feasible region of a fit's parameters; the tool is that of the first recording's model.

        Raises InputError when a name is unknown, the tool's moments are not linear in the parameters, or the
        constraints are infeasible together (it names an irreducible subset).
        """
        names = [p.name for p in unknowns.parameters]
        bounds = self._bounds
        require_known_names(bounds.ends, names, bounds.where)
        inertia = pseudo_inertia(unknowns.models[0]) if self.physical or self.prior is not None else None
        divergence = None if self.prior is None or inertia is None else self.prior.divergence(inertia, names)
        weighted = divergence is not None and divergence.weight > 0
        region = FeasibleRegion(
            parameters=unknowns.parameters,
            stated={names.index(name): interval for name, interval in bounds.ends.items()},
            inertia=inertia.over(names) if inertia is not None and self.physical and not weighted else None,
            prior=divergence if weighted else None,
            where=bounds.where,
        )
        require_interior(region)
        return region


StatedConstraints: TypeAlias = Constraints | Bounds | Mapping[str, Interval]
"""What a fit takes: constraints, or bounds alone."""
