"""Propagation of signal errors to the predicted wrench: sensitivities and second-order bias."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache

from estimation.errors_in_variables.input_noise import InputNoise
from estimation.recordings.recording import QUATERNION, Recording
from estimation.recordings.signal_unit import ORIENTATION_ERRORS
from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import VectorFunction, compiled_prediction
from modeling.errors import InputError
from modeling.kinematics.planar_arm import POSE_SIGNALS, PlanarArm

JOINT_SIGNAL = r"d{0,2}q\d+"


@dataclass(frozen=True, kw_only=True)
class BiasCorrectedModel(WrenchModel):
    """A model whose prediction from noisy signals is unbiased to second order in the noise.

    E f(u + e) = f(u) + curvature, with curvature = 1/2 sum_ij cov_ij d²f / du_i du_j to second order in e (and
    exactly where f is quadratic: dphi²); it is subtracted from the load.
    """

    curvature: sp.ImmutableMatrix

    @cached_property
    def load(self) -> sp.Matrix:
        """The load less its bias due to the noise of the signals."""
        return super().load - self.curvature


@dataclass(frozen=True)
class ErrorPropagation:
    """Load of a model as a function of the errors e (s,) of its input signals.

    `lengths` are the link lengths (m) when the motion is recorded as joint angles, else empty; `base` is the angle of
    the arm's base (rad).
    """

    model: WrenchModel
    names: tuple[str, ...]
    lengths: tuple[float, ...] = ()
    base: float = 0.0

    @classmethod
    def of(cls, model: WrenchModel, recording: Recording, noise: InputNoise) -> ErrorPropagation:
        """The load of a model for a recording whose signals have this noise.

        Raises InputError when the recording has no signal of such a name, or the model uses none of them.
        """
        arm = recording.arm if isinstance(recording.arm, PlanarArm) else PlanarArm(())
        lengths = arm.link_lengths
        known = {*recording.signals, *(ORIENTATION_ERRORS if "qw" in recording.signals else ())}
        for name in noise.names:
            if re.fullmatch(JOINT_SIGNAL, name) and not lengths and name in known:
                raise InputError(
                    what=f"the noise of '{name}' can be propagated through a planar arm only",
                    where=recording.name,
                    remedy=f"state the noise of the sensor's motion ({', '.join(ORIENTATION_ERRORS)}, wx ..) instead",
                )
            if name not in known:
                raise InputError(
                    what=f"there is no signal '{name}'",
                    where=recording.name,
                    remedy="state the noise of signals that the recording has",
                )
        found = _cached(cls(model, noise.names, tuple(lengths), arm.base))
        if not found._symbols:
            raise InputError(
                what=f"the model uses none of {', '.join(noise.names)}",
                where=recording.name,
                remedy="state the noise of signals on which its prediction depends",
            )
        return found

    @cached_property
    def errors(self) -> tuple[sp.Symbol, ...]:
        """Symbols of the errors."""
        return tuple(sp.Symbol(f"error_{name}", real=True) for name in self.names)

    @cached_property
    def _perturbed(self) -> Mapping[sp.Symbol, sp.Expr]:
        """Signals with their errors; poses of an arm with joint signals by its kinematics."""
        error = dict(zip(self.names, self.errors, strict=True))
        own = {sp.Symbol(name, real=True): sp.Symbol(name, real=True) + e for name, e in error.items()}
        if set(ORIENTATION_ERRORS) & set(self.names):
            own |= _rotated_quaternion(*(error.get(name, sp.S.Zero) for name in ORIENTATION_ERRORS))
        if not any(re.fullmatch(JOINT_SIGNAL, name) for name in self.names):
            return own
        kinematics = PlanarArm(self.lengths, self.base).kinematics
        shift = {sp.Symbol(n, real=True): error.get(n, sp.S.Zero) for n in POSE_SIGNALS}
        return own | {s: kinematics[s.name].xreplace(own) + extra for s, extra in shift.items()}

    @cached_property
    def _symbols(self) -> list[sp.Symbol]:
        """The signals (a) of the load that have errors."""
        return [symbol for symbol in self._perturbed if symbol in self.model.load.free_symbols]

    @cached_property
    def _signals(self) -> sp.Matrix:
        """These signals with their errors, (a, 1)."""
        return sp.Matrix(len(self._symbols), 1, [self._perturbed[symbol] for symbol in self._symbols])

    @cached_property
    def _gradient(self) -> sp.Matrix:
        """d load / d signal, (p, a)."""
        return self.model.load.jacobian(self._symbols)

    @cached_property
    def _signal_jacobian(self) -> sp.Matrix:
        """d signal / d error at zero error, (a, s)."""
        return self._at_zero_error(self._signals.jacobian(self.errors))

    @cached_property
    def slopes(self) -> sp.Matrix:
        """d load / d error at zero error, (p, s)."""
        return self._gradient * self._signal_jacobian

    def curvature(self, covariance: sp.Matrix) -> sp.Matrix:
        """Second-order bias 1/2 sum_ij cov_ij d² load / d error_i d error_j at zero error, (p, 1).

        By the chain rule: the Hessian in the signals with their covariance, and the gradient in the signals with their
        own second-order bias.
        """
        covariances, bias = (
            self._signal_jacobian * covariance * self._signal_jacobian.T,
            sp.zeros(self._gradient.rows, 1),
        )
        for a, (slope, hessian) in enumerate(zip(self._gradient_slopes, self._signal_hessians, strict=True)):
            bias += slope * covariances[:, a]
            bias += self._gradient[:, a] * (hessian.T * covariance).trace()
        return bias / 2

    @cached_property
    def _gradient_slopes(self) -> list[sp.Matrix]:
        """Derivative of the gradient, (p, a), by each signal."""
        return [self._gradient.diff(symbol) for symbol in self._symbols]

    @cached_property
    def _signal_hessians(self) -> list[sp.Matrix]:
        """d² signal / d error², (s, s), of each signal at zero error."""
        return [self._at_zero_error(sp.hessian(signal, self.errors)) for signal in self._signals]

    def _at_zero_error(self, expression: sp.Matrix) -> sp.Matrix:
        return expression.xreplace(dict.fromkeys(self.errors, sp.S.Zero))

    def unbiased(self, noise: InputNoise, repeats: int) -> WrenchModel:
        """The bias-corrected model for signals with this noise, averaged over `repeats`."""
        return _bias_corrected(self, tuple(map(tuple, (noise.covariance / repeats).tolist())))

    @cached_property
    def emitted(self) -> VectorFunction:
        """`slopes` (p s,), channel by channel, as a function of signals and parameters."""
        expression = self.slopes.reshape(self.slopes.rows * self.slopes.cols, 1)
        return VectorFunction.of(expression, self.model.inputs_of(expression), compiled_prediction(self.model).symbols)


@lru_cache(maxsize=32)
def _cached(load: ErrorPropagation) -> ErrorPropagation:
    """The first equal object, with its cached derivatives."""
    return load


@lru_cache(maxsize=32)
def _bias_corrected(load: ErrorPropagation, covariance: tuple[tuple[float, ...], ...]) -> WrenchModel:
    """The bias-corrected model for errors of this covariance (s, s): recordings of one noise share its compilation."""
    own = {f.name: getattr(load.model, f.name) for f in fields(load.model)}
    return BiasCorrectedModel(**own, curvature=sp.ImmutableMatrix(load.curvature(sp.Matrix(covariance))))


def _rotated_quaternion(x: sp.Expr, y: sp.Expr, z: sp.Expr) -> dict[sp.Symbol, sp.Expr]:
    """The quaternion q ⊗ (e/2, 1 - |e|²/8): rotated in the sensor frame by e (rad), to second order."""
    qx, qy, qz, w = (sp.Symbol(name, real=True) for name in QUATERNION)
    v, half = sp.Matrix([qx, qy, qz]), sp.Matrix([x, y, z]) / 2
    cosine = 1 - half.dot(half) / 2
    vector = w * half + cosine * v + v.cross(half)
    return dict(zip((qx, qy, qz, w), (*vector, w * cosine - v.dot(half)), strict=True))
