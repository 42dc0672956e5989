"""CasADi state: what a model remembers as one column, and how it moves on by a sample."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np

from modeling.emit.fitted import FittedModel
from modeling.running_memory import SampledMemory


@dataclass(eq=False)
class CasadiState:
    """Whether it has started, then what each stage holds, by name: nothing but zeros before the first sample.

    sizes   lengths of swing and drive (of a bend), played, lag, outputs (of the lag, newest first, for the delay), and
            of the zeros and readings that wait (oldest first)
    next    what they will be after this sample
    """

    channels: int
    memory: SampledMemory | None
    sizes: dict[str, int]
    next: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, fitted: FittedModel) -> Self:
        """The state of a model, before its first sample."""
        p, memory, bend = fitted.size, fitted.memory, fitted.bend
        sizes = {"swing": 2 * bend.size, "drive": bend.size} if bend is not None else {}
        sizes |= {"played": p} if "width" in fitted.parts else {}
        if memory is not None:
            held = {"lag": memory.order, "outputs": memory.held - 1, "zeros": memory.wait, "readings": memory.wait}
            sizes |= {name: p * count for name, count in held.items()}
        return cls(p, memory, sizes)

    @cached_property
    def column(self) -> Any:
        """The whole state before this sample; empty for a model that remembers nothing."""
        import casadi as ca

        return ca.SX.sym("state", 1 + sum(self.sizes.values()) if self.sizes else 0)

    @property
    def started(self) -> Any:
        """Whether there was a sample before."""
        return self.column[0]

    @cached_property
    def held(self) -> dict[str, Any]:
        """What each stage holds before this sample."""
        import casadi as ca

        ends = np.cumsum([1, *self.sizes.values()]).tolist()
        return dict(zip(self.sizes, ca.vertsplit(self.column, [0, *ends])[1:], strict=True)) if self.sizes else {}

    @property
    def following(self) -> Any:
        """The whole state after this sample."""
        import casadi as ca

        return ca.vertcat(ca.SX.ones(1 if self.sizes else 0), *(self.next[name] for name in self.sizes))

    def advanced(self, parts: dict[str, Any], reading: Any) -> tuple[Any, Any]:
        """Prediction (p,), and the reading (p,) that belongs to it."""
        import casadi as ca

        load, zero = parts["load"], parts["zero"]
        if "width" in parts:
            load = ca.fmin(ca.fmax(self._before("played", load), load - parts["width"]), load + parts["width"])
            self.next["played"] = load
        if self.memory is not None:
            load = self._delayed(self.memory, self._lagged(self.memory, load))
            zero, reading = self._waiting("zeros", zero), self._waiting("readings", reading)
        prediction = load + zero
        if "level" in parts:
            prediction = ca.fmin(ca.fmax(prediction, -parts["level"]), parts["level"])
        return prediction, reading

    def _before(self, name: str, first: Any) -> Any:
        """What a stage holds, and what it holds when there was no sample before."""
        import casadi as ca

        return ca.if_else(self.started, self.held[name], first)

    def _lagged(self, memory: SampledMemory, load: Any) -> Any:
        import casadi as ca

        if not memory.order:
            self.next["lag"] = self.held["lag"]
            return memory.D * load
        x = ca.reshape(self._before("lag", ca.vec(ca.DM(memory.rest) @ load.T)), memory.order, self.channels)
        self.next["lag"] = ca.vec(ca.DM(memory.A) @ x + ca.DM(memory.B) @ load.T)
        return (ca.DM(memory.C).T @ x).T + memory.D * load

    def _delayed(self, memory: SampledMemory, output: Any) -> Any:
        import casadi as ca

        earlier = self._before("outputs", ca.repmat(output, memory.held - 1, 1)) if memory.held > 1 else ca.SX(0, 1)
        outputs = ca.vertcat(output, earlier)
        self.next["outputs"] = outputs[: self.sizes["outputs"]]
        late = ca.vertsplit(outputs, self.channels)[memory.first :]
        return sum(float(weight) * one for weight, one in zip(memory.weights, late, strict=True))

    def _waiting(self, name: str, newest: Any) -> Any:
        """The oldest of those that wait, and this one at their end."""
        import casadi as ca

        if not self.sizes[name]:
            self.next[name] = self.held[name]
            return newest
        count = self.sizes[name] // self.channels
        line = ca.vertcat(self._before(name, ca.repmat(newest, count, 1)), newest)
        self.next[name] = line[self.channels :]
        return line[: self.channels]
