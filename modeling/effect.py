"""An effect: one physical thing that the rigid-tip model leaves out, as a perturbation of one stage of the chain."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from modeling import symbolic as sp
from modeling.chain import Chain, Stage
from modeling.parameter import Parameter
from modeling.space import Space

if TYPE_CHECKING:
    from modeling.kinematics import Arm

Values = dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Extent:
    """What a recording spans: where nuisance parameters can lie.

    low, high   corners of the box that the sensor origin visits in the world, m (empty without a position)
    start, end  the time of the first and last sample, s
    reach       how far along the tip a force may act, m
    events      intervals (s) in which the recording was seen to differ from its other repeats
    tones       frequencies (Hz) in the residual that are not the motion's, loudest first
    largest     per channel the largest |reading|, N or N m
    swing       per channel half of the peak-to-peak of the predicted load, N or N m
    inertia     of the tool about the sensor, kg m²
    """

    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    start: float = 0.0
    end: float = 0.0
    reach: float = 0.5
    events: tuple[tuple[float, float], ...] = ()
    tones: tuple[float, ...] = ()
    largest: tuple[float, ...] = ()
    swing: tuple[float, ...] = ()
    inertia: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Combination:
    """Points of a search domain whose sensitivities are sums of those at other points, the building blocks.

    blocks   values of the nuisance parameters at b points
    index    (g, s) which blocks each of g points is the sum of, with the weights (g, s)
    """

    blocks: tuple[Values, ...]
    index: tuple[tuple[int, ...], ...]
    weights: tuple[tuple[float, ...], ...]

    @classmethod
    def plain(cls, points: Sequence[Values]) -> Combination:
        """Every point its own block."""
        return cls(blocks=tuple(points), index=tuple((i,) for i in range(len(points))), weights=((1.0,),) * len(points))


@dataclass(frozen=True)
class Effect(ABC):
    """A missing piece of physics. Everything else (column, refit, design, text, code) follows from `perturb`.

    Subclasses state their equation, sign and units in the docstring; `id` is stable, `advice` says what to look at
    on the rig, `confused_with` what looks alike. `per_recording` effects (events, a wandering zero) do not carry over
    to another recording; `needs_repeats` are those that a single run of a motion cannot tell from slow physics,
    `needs_joints` those that act on joints or links.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    stage: ClassVar[Stage]
    equation: ClassVar[str]
    advice: ClassVar[str]
    confused_with: ClassVar[str] = ""
    spaces: ClassVar[tuple[Space, ...]] = (Space.PLANE, Space.SPACE)
    per_recording: ClassVar[bool] = False
    needs_repeats: ClassVar[bool] = False
    needs_joints: ClassVar[bool] = False

    @property
    def designable(self) -> bool:
        """Whether motions can be designed for it.

        It lasts from one recording to the next, and what it does is a function of the motion of one instant, or linear
        in the motion's past.
        """
        return not self.per_recording and self.stage.adds

    @abstractmethod
    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The parameters that this effect adds, named without the effect's id."""

    @abstractmethod
    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """The chain with this effect in it; `p` holds the expressions of the parameters by their own names."""

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Values from which a search starts; one empty set when there is nothing to search.

        Each names every nuisance parameter, and those amplitudes (the same ones each time) that have no useful
        derivative at their nominal value: what these do is then taken from the difference between the value named and
        the nominal.
        """
        return ({},)

    def combination(self, points: Sequence[Values]) -> Combination:
        """How the sensitivities at these nuisance values add up from fewer, exactly; by default each stands alone."""
        return Combination.plain(points)

    def fitting(self, arm: Arm | None) -> Self:
        """The effect for a model of that arm."""
        return self

    def qualified(self, space: Space) -> tuple[Parameter, ...]:
        """The parameters under their full names, `<id>.<name>`."""
        return tuple(
            Parameter(
                name=f"{self.id}.{p.name}",
                unit=p.unit,
                nominal=p.nominal,
                bounds=p.bounds,
                nuisance=p.nuisance,
                start=p.start,
            )
            for p in self.parameters(space)
        )

    def applied(self, chain: Chain) -> Chain:
        """The chain with this effect in it, in terms of its qualified parameters' symbols."""
        own = self.parameters(chain.space)
        symbols = (p.symbol for p in self.qualified(chain.space))
        return self.perturb(chain, {p.name: symbol for p, symbol in zip(own, symbols, strict=True)})
