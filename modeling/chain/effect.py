"""Abstract effect: physics that the rigid-tool model omits, as a perturbation of one stage of the chain."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, ClassVar, Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.errors import InputError, kind_of
from modeling.parameter import Parameter, Role
from modeling.sketch import Sketch
from modeling.space import Space

if TYPE_CHECKING:
    from modeling.kinematics.arm import Arm

NuisanceValues = dict[str, float]


@dataclass(frozen=True, kw_only=True)
class SearchDomain:
    """Search domain of nuisance parameters, from the range of a recording.

    low, high   corners of the bounding box of the sensor origin in the world, m (empty without a position)
    start, end  time of the first and last sample, s
    reach       largest distance along the tip at which a force may act, m
    events      intervals (s) of detected transient events, where the recording differs from its other repeats
    contacts    of these the intervals (s) of events of any shape, each of which a contact there explains
    tones       frequencies (Hz) of non-excited lines in the residual, largest first
    largest     per channel the largest |reading|, N or N m
    swing       per channel the amplitude (half peak-to-peak) of the predicted load, N or N m
    inertia     of the tool about the sensor, kg m²
    """

    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    start: float = 0.0
    end: float = 0.0
    reach: float = 0.5
    events: tuple[tuple[float, float], ...] = ()
    contacts: tuple[tuple[float, float], ...] = ()
    tones: tuple[float, ...] = ()
    largest: tuple[float, ...] = ()
    swing: tuple[float, ...] = ()
    inertia: float = 0.0


@dataclass(frozen=True, kw_only=True)
class GridSuperposition:
    """Grid points whose sensitivities are weighted sums of those at fewer points (blocks).

    blocks   values of the nuisance parameters at b points
    index    (g, s) the blocks that make up each of g points, with the weights (g, s)
    """

    blocks: tuple[NuisanceValues, ...]
    index: tuple[tuple[int, ...], ...]
    weights: tuple[tuple[float, ...], ...]

    @classmethod
    def plain(cls, points: Sequence[NuisanceValues]) -> GridSuperposition:
        """Every grid point as its own block."""
        return cls(blocks=tuple(points), index=tuple((i,) for i in range(len(points))), weights=((1.0,),) * len(points))


@dataclass(frozen=True)
class Effect(ABC):
    """A physical effect; sensitivity, refit, design, text and code all follow from `perturb`.

    Subclasses state their equation, sign and units in the docstring. What an effect must have:

    id             stable: results, model files and commands know the effect by it
    title          what it is, in few words
    stage          on which it acts
    equation       with its sign, in plain text
    advice         what to check on the rig

    What the catalogue's effects have besides, and others may:

    confused_with  names effects that it may be aliased with
    shows          what of it is seen in the residual of the rigid tool, a sentence
    provoked_by    which motion or test makes it large, or separates it from what resembles it, a sentence
    disturbance    of a recording-specific effect, what messages call it
    letter         of parameters that are named as their channels, in equations
    amounts        of each parameter, by its name or its unit, a size that clearly shows: what tests simulate
    sketch         drawn in reports, workbench and manual, with the names of the parameters (`modeling.sketch`)

    What it needs, and how it is used:

    spaces         in which it is defined
    per_recording  a recording-specific disturbance (an event, a bias drift)
    needs_repeats  aliased with slow physics in a single run of a motion
    needs_joints   acts on joints or links, and so changes the motion
    reads_motion   after the load, it depends on the motion
    scales_mass    it scales the readings as the mass does, which recordings of one weight do not tell apart
    """

    id: ClassVar[str]
    title: ClassVar[str]
    stage: ClassVar[Stage]
    equation: ClassVar[str]
    advice: ClassVar[str]
    confused_with: ClassVar[str] = ""
    shows: ClassVar[str] = ""
    provoked_by: ClassVar[str] = ""
    disturbance: ClassVar[str] = ""
    letter: ClassVar[str] = "b"
    amounts: ClassVar[Mapping[str, float]] = {}
    sketch: ClassVar[Sketch] = ()
    spaces: ClassVar[tuple[Space, ...]] = (Space.PLANE, Space.SPACE)
    per_recording: ClassVar[bool] = False
    needs_repeats: ClassVar[bool] = False
    needs_joints: ClassVar[bool] = False
    reads_motion: ClassVar[bool] = False
    scales_mass: ClassVar[bool] = False

    @property
    def designable(self) -> bool:
        """Whether exciting trajectories can be designed for it.

        It is not recording-specific, and its contribution is a static function of the motion followed by a linear
        filter.
        """
        return not self.per_recording and self.stage.adds

    @abstractmethod
    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The parameters that this effect adds, named without the effect's id."""

    @abstractmethod
    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """The chain with this effect in it; `p` holds the expressions of the parameters by their own names."""

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Grid of nuisance values for the search; a single empty set without nuisance parameters.

        Each point has every nuisance parameter that is free in the `restricted` effect, and those amplitudes (the same
        ones each time) that have no useful derivative at their nominal value: their sensitivity is then the finite
        difference between the value given and the nominal one.
        """
        return ({},)

    def combination(self, points: Sequence[NuisanceValues]) -> GridSuperposition:
        """Exact superposition of the sensitivities at these nuisance values; by default each is its own block."""
        return GridSuperposition.plain(points)

    def fitting(self, arm: Arm | None) -> Self:
        """The effect for a model of that arm."""
        return self

    def restricted(self, space: Space) -> Self:
        """The effect with those parameters fixed that only significant evidence frees; by default itself."""
        return self

    def unrestricted(self, space: Space) -> Self:
        """The effect with all of its parameters free; by default itself."""
        return self

    def at_rest(self) -> Self:
        """The effect for poses at rest, with what is fixed that they cannot tell from the tool; by default itself."""
        return self

    def qualified(self, space: Space) -> tuple[Parameter, ...]:
        """The parameters under their full names, `<id>.<name>`."""
        return tuple(replace(p, name=f"{self.id}.{p.name}") for p in self.parameters(space))

    def has_role(self, role: Role, space: Space) -> bool:
        """Whether one of its parameters has that role."""
        return any(p.role is role for p in self.parameters(space))

    def applied(self, chain: Chain) -> Chain:
        """The chain with this effect in it, in terms of its qualified parameters' symbols; fixed ones are numbers."""
        short, full = self.parameters(chain.space), self.qualified(chain.space)
        values = (_number(p.nominal) if p.fixed else p.symbol for p in full)
        return self.perturb(chain, {p.name: value for p, value in zip(short, values, strict=True)})


def _number(value: float) -> sp.Expr:
    return sp.Float(value) if value else sp.S.Zero


def effects_of(given: Effect | str | Iterable[Effect | str]) -> tuple[Effect, ...]:
    """The effects of an argument that is one or several, or their ids; InputError, in a sentence, for what is none."""
    whole: object = given
    several: tuple[object, ...] = (
        tuple(whole) if isinstance(whole, Iterable) and not isinstance(whole, str) else (whole,)
    )
    return tuple(_effect(one) for one in several)


def _effect(one: object) -> Effect:
    if isinstance(one, Effect):
        return one
    if isinstance(one, str):
        named: Effect = import_module("modeling.effects").named(one)  # the catalogue is made of subclasses
        return named
    remedy = "take one of the catalogue, tw.effects.named('viscous_drag'), or write one"
    raise InputError(what=f"{kind_of(one)} is no effect", where="effects", remedy=remedy)
