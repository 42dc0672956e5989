"""NoisyLoad: how small errors in the signals of motion move the reading that a model predicts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache

from estimation.noisy_motion.input_noise import TURNS, InputNoise
from estimation.recording import QUATERNION, Recording
from modeling import symbolic as sp
from modeling.arm import POSE_SIGNALS, PlanarArm
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.prediction import Emitted, compiled

JOINT_SIGNAL = r"d{0,2}q\d+"


@dataclass(frozen=True, kw_only=True)
class UnbiasedModel(WrenchModel):
    """A model whose prediction from noisy signals has, on average, the value that it has for the true ones.

    E f(u + e) = f(u) + curvature, with curvature = 1/2 sum_ij cov_ij d²f / du_i du_j to second order in e (and
    exactly where f is quadratic: dphi²); it is taken off the load.
    """

    curvature: sp.ImmutableMatrix

    @cached_property
    def load(self) -> sp.Matrix:
        """The load less what the noise of the signals adds to it on average."""
        return super().load - self.curvature


@dataclass(frozen=True)
class NoisyLoad:
    """The load of a model as a function of the errors e (s,) of the signals that go into it.

    `lengths` are those of the arm (m) when the motion is recorded as joint angles, else empty.
    """

    model: WrenchModel
    names: tuple[str, ...]
    lengths: tuple[float, ...] = ()

    @classmethod
    def of(cls, model: WrenchModel, recording: Recording, noise: InputNoise) -> NoisyLoad:
        """The load of a model for a recording whose signals have this noise.

        Raises InputError when the recording has no signal of such a name, or the model takes none of them.
        """
        lengths = recording.arm.link_lengths if isinstance(recording.arm, PlanarArm) else ()
        known = {*recording.signals, *(TURNS if "qw" in recording.signals else ())}
        for name in noise.names:
            if re.fullmatch(JOINT_SIGNAL, name) and not lengths and name in known:
                raise InputError(
                    what=f"the noise of '{name}' is followed through a planar arm only",
                    where=recording.name,
                    remedy=f"state the noise of the sensor's motion ({', '.join(TURNS)}, wx ..) instead",
                )
            if name not in known:
                raise InputError(
                    what=f"there is no signal '{name}' whose noise could matter",
                    where=recording.name,
                    remedy="state the noise of signals that the recording has",
                )
        found = _once(cls(model, noise.names, tuple(lengths)))
        if not found._symbols:
            raise InputError(
                what=f"the model takes none of {', '.join(noise.names)}",
                where=recording.name,
                remedy="state the noise of signals that move its prediction",
            )
        return found

    @cached_property
    def errors(self) -> tuple[sp.Symbol, ...]:
        """The errors' symbols."""
        return tuple(sp.Symbol(f"error_{name}", real=True) for name in self.names)

    @cached_property
    def _moved(self) -> Mapping[sp.Symbol, sp.Expr]:
        """Signals in terms of themselves and the errors; poses of a jointed arm through its kinematics."""
        error = dict(zip(self.names, self.errors, strict=True))
        own = {sp.Symbol(name, real=True): sp.Symbol(name, real=True) + e for name, e in error.items()}
        if set(TURNS) & set(self.names):
            own |= _turned(*(error.get(name, sp.S.Zero) for name in TURNS))
        if not any(re.fullmatch(JOINT_SIGNAL, name) for name in self.names):
            return own
        kinematics = PlanarArm(self.lengths).kinematics
        shift = {sp.Symbol(n, real=True): error.get(n, sp.S.Zero) for n in POSE_SIGNALS}
        return own | {s: kinematics[s.name].xreplace(own) + extra for s, extra in shift.items()}

    @cached_property
    def _symbols(self) -> list[sp.Symbol]:
        """The a signals in the load that have errors."""
        return [symbol for symbol in self._moved if symbol in self.model.load.free_symbols]

    @cached_property
    def _signals(self) -> sp.Matrix:
        """These signals in terms of themselves and the errors, (a, 1)."""
        return sp.Matrix(len(self._symbols), 1, [self._moved[symbol] for symbol in self._symbols])

    @cached_property
    def _gradient(self) -> sp.Matrix:
        """d load / d signal, (p, a)."""
        return self.model.load.jacobian(self._symbols)

    @cached_property
    def _paths(self) -> sp.Matrix:
        """d signal / d error at no error, (a, s)."""
        return self._still(self._signals.jacobian(self.errors))

    @cached_property
    def slopes(self) -> sp.Matrix:
        """d load / d error at no error, (p, s)."""
        return self._gradient * self._paths

    def curvature(self, covariance: sp.Matrix) -> sp.Matrix:
        """1/2 sum_ij cov_ij d² load / d error_i d error_j at no error, (p, 1).

        By the chain rule: the second derivative in the signals along their slopes, and the slope in the signals along
        their own curvature.
        """
        spread, bent = self._paths * covariance * self._paths.T, sp.zeros(self._gradient.rows, 1)
        for a, symbol in enumerate(self._symbols):
            bent += self._gradient.diff(symbol) * spread[:, a]
            bent += self._gradient[:, a] * self._own_curvature(self._signals[a], covariance)
        return bent / 2

    def _own_curvature(self, signal: sp.Expr, covariance: sp.Matrix) -> sp.Expr:
        hessian = self._still(sp.hessian(signal, self.errors))
        return (hessian.T * covariance).trace()

    def _still(self, expression: sp.Matrix) -> sp.Matrix:
        return expression.xreplace(dict.fromkeys(self.errors, sp.S.Zero))

    def unbiased(self, noise: InputNoise, repeats: int) -> WrenchModel:
        """The model for signals with this noise, averaged over `repeats`."""
        curvature = self.curvature(sp.Matrix(noise.covariance / repeats))
        own = {f.name: getattr(self.model, f.name) for f in fields(self.model)}
        return UnbiasedModel(**own, curvature=sp.ImmutableMatrix(curvature))

    @cached_property
    def emitted(self) -> Emitted:
        """`slopes` (p s,), channel by channel, as a function of signals and parameters."""
        expression = self.slopes.reshape(self.slopes.rows * self.slopes.cols, 1)
        return Emitted.of(expression, self.model.inputs_of(expression), compiled(self.model).symbols)


@lru_cache(maxsize=32)
def _once(load: NoisyLoad) -> NoisyLoad:
    """The same load again, with all that was derived of it."""
    return load


def _turned(x: sp.Expr, y: sp.Expr, z: sp.Expr) -> dict[sp.Symbol, sp.Expr]:
    """The quaternion q ⊗ (e/2, 1 - |e|²/8): turned in the sensor frame by e (rad), to second order."""
    qx, qy, qz, w = (sp.Symbol(name, real=True) for name in QUATERNION)
    v, half = sp.Matrix([qx, qy, qz]), sp.Matrix([x, y, z]) / 2
    cosine = 1 - half.dot(half) / 2
    vector = w * half + cosine * v + v.cross(half)
    return dict(zip((qx, qy, qz, w), (*vector, w * cosine - v.dot(half)), strict=True))
