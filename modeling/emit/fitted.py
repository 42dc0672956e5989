"""FittedModel: a model with the numbers of a fit, as what emitted code is made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.contact import components
from modeling.contact_gain import contact_gain
from modeling.emit.derivative import derivative
from modeling.emit.operations import Operations
from modeling.emit.program import Program
from modeling.model import WrenchModel
from modeling.parameter import Parameter
from modeling.running import inputs_of, remembers, running_bend, sampled_memory
from modeling.running_bend import SampledBend
from modeling.running_memory import SampledMemory

Array = NDArray[np.float64]

DEAREST = 100_000
"""Operations of a sample times parameters above which no derivative is emitted: it would be megabytes of code."""


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model, its parameters theta (k,) in its order, and the time dt (s) between samples where it remembers.

    The effects are those that last beyond one recording. `dropped` are the others.
    """

    model: WrenchModel
    theta: Array
    dt: float | None
    dropped: tuple[str, ...]

    @classmethod
    def of(cls, model: WrenchModel, theta: Array, dt: float | None = None) -> FittedModel:
        """The lasting part of a fitted model; dt (s) is asked for by what remembers."""
        values = dict(zip((p.name for p in model.parameters), map(float, theta), strict=True))
        kept = np.array([values[p.name] for p in model.lasting.parameters])
        return cls(model.lasting, kept, dt, tuple(e.id for e in model.effects if e.per_recording))

    @cached_property
    def memory(self) -> SampledMemory | None:
        """The memory in steps of dt, None without one.

        Raises InputError when the model remembers and there is no dt, or when it cannot be run sample by sample.
        """
        return sampled_memory(self.model, self.theta, self.dt)

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """The signals of a sample, sorted by name."""
        return inputs_of(self.model)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the contact wrench's components."""
        return components(self.model.space)

    @property
    def size(self) -> int:
        """The number of channels p."""
        return len(self.model.channels)

    # ------------------------------------------------------------------------------- what a sample takes

    @cached_property
    def parts(self) -> dict[str, sp.Matrix]:
        """What has to be known of a sample, (p,) each, by name: load and zero, and where they exist width and level.

        width are the half-widths of the play between load and memory, level where readings are clipped.
        """
        chain = self.model.chain
        found = {"load": self.model.load, "zero": self.model.zero, "width": chain.play, "level": chain.level}
        return {name: part for name, part in found.items() if part is not None}

    @cached_property
    def gain(self) -> sp.Matrix:
        """The contact gain (p, p), of parameters alone."""
        return contact_gain(self.model)

    @cached_property
    def program(self) -> Program:
        """The elements of the parts, one part after the other."""
        return Program.of([e for part in self.parts.values() for e in part], self.model.definitions)

    @cached_property
    def bend(self) -> SampledBend | None:
        """How the tool's bend goes on in steps of dt, None without one.

        Raises InputError when there is one and no dt, or when the tool's inertia is not that of a body.
        """
        running = running_bend(self.model, self.theta, self.dt)
        return None if running is None else running.sampled

    @cached_property
    def equilibrium(self) -> Program | None:
        """What is zero when the bend obeys its spring (d,), then its derivative (d, 3 d) in the bend's signals."""
        bend = self.model.chain.bend
        if bend is None:
            return None
        balance = Program.of(list(self.model.chain.equilibrium()), self.model.definitions).shared
        slopes = derivative(balance, bend.signals)
        return Program.of([*balance.results, *slopes.results], slopes.steps)

    @cached_property
    def inverse_gain(self) -> Array | None:
        """Inverse (p, p) of the contact gain where that is made of numbers alone, else None."""
        if self.gain.free_symbols:
            return None
        return np.asarray(np.linalg.inv(np.array(self.gain.tolist(), dtype=float)))

    @property
    def rest(self) -> Operations:
        """What a sample takes after its parts are known: play, memory, zero and a contact with a constant gain."""
        p, memory = self.size, self.memory
        each = Operations(sums=1)
        if "width" in self.parts:
            each += Operations(sums=2)
        if memory is not None:
            r, taps = memory.order, len(memory.weights)
            each += Operations(sums=r + r * r, products=1 + r + r * (1 + r))
            each += Operations(sums=taps - 1, products=taps if memory.held > 1 else 0)
        each += Operations(sums=1 + p - 1, products=p)
        return Operations.sum([each] * p)

    # ------------------------------------------------------------------------------------ its parameters

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those that a sample takes, in the model's order."""
        used = self.program.free_symbols | self.gain.free_symbols
        used |= set() if self.equilibrium is None else self.equilibrium.free_symbols
        return tuple(p for p in self.model.parameters if p.symbol in used)

    @cached_property
    def values(self) -> dict[str, float]:
        """All parameters of the model, by name."""
        return dict(zip((p.name for p in self.model.parameters), map(float, self.theta), strict=True))

    @cached_property
    def fixed(self) -> tuple[Parameter, ...]:
        """Those that the memory was made of: their values are in its numbers."""
        used = self.model.memory.free_symbols
        return tuple(p for p in self.model.parameters if p.symbol in used)

    # ------------------------------------------------------------------------------------ its derivative

    @cached_property
    def sensitivity(self) -> Program | None:
        """Derivative (p, len(parameters)) of load + zero, row by row.

        None where the tool bends, since that takes time, and where it would be too long (DEAREST).
        """
        dear = self.program.shared.operations.total * len(self.parameters) > DEAREST
        if self.equilibrium is not None or dear:
            return None
        reading = Program.of(list(self.model.load + self.model.zero), self.model.definitions)
        return derivative(reading.shared, [p.symbol for p in self.parameters])

    @cached_property
    def linear(self) -> bool:
        """Whether a reading is the derivative times the parameters: nothing else acts on it, and it is linear."""
        own = {p.symbol for p in self.model.parameters}
        if self.sensitivity is None or remembers(self.model) or len(self.parts) > 2:
            return False
        if self.sensitivity.free_symbols & own:
            return False
        return not any(e.xreplace(dict.fromkeys(own, sp.S.Zero)) for e in self.model.load + self.model.zero)

    @property
    def derivative_name(self) -> str:
        """What the derivative is called: a regressor where it is one."""
        return "regressor" if self.linear else "sensitivity"
