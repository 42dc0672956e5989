"""Constraints: what is known of the parameters besides the recordings."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.constrained.bounds import Bounds
from estimation.constrained.contradiction import require_interior
from estimation.constrained.named_numbers import require_known
from estimation.constrained.prior import Prior
from estimation.constrained.region import Region
from estimation.layout import Layout
from modeling.pseudo_inertia import pseudo_inertia


@dataclass(frozen=True, kw_only=True)
class Constraints:
    """Intervals of parameters, physical consistency of the tool, and a reference tool; each may be left out.

    physical    the pseudo-inertia is not negative: some distribution of mass has these moments
    prior       keeps the tool physically consistent by itself, where its weight is not 0
    """

    bounds: Bounds | None = None
    physical: bool = False
    prior: Prior | None = None

    def region(self, unknowns: Layout) -> Region:
        """Where the unknowns of a fit may be; the tool is the one that the first recording has.

        Raises InputError when a name is unknown, the tool's moments are not linear in the unknowns, or the constraints
        contradict each other (the smallest set of them that does).
        """
        names = [p.name for p in unknowns.parameters]
        bounds = self.bounds or Bounds({})
        require_known(bounds.intervals, names, bounds.where)
        inertia = pseudo_inertia(unknowns.models[0]) if self.physical or self.prior is not None else None
        divergence = None if self.prior is None or inertia is None else self.prior.divergence(inertia, names)
        believed = divergence is not None and divergence.weight > 0
        region = Region(
            parameters=unknowns.parameters,
            stated={names.index(name): interval for name, interval in bounds.intervals.items()},
            inertia=inertia.over(names) if inertia is not None and self.physical and not believed else None,
            prior=divergence if believed else None,
            where=bounds.where,
        )
        require_interior(region)
        return region
