"""Trial: an effect of one's own evaluated at random places, before any recording sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain import rigid_chain
from modeling.effect import Extent
from modeling.errors import InputError
from modeling.own.formulas import formulas_of
from modeling.prediction import Emitted, Signals
from modeling.space import Space

if TYPE_CHECKING:
    from modeling.own.formula_effect import FormulaEffect

Array = NDArray[np.float64]

PLACES = 1024
"""Random places at which an effect is tried: a formula that acts in a hundredth of them is still seen to act."""
DECADES = 2.0
"""Signals are tried from 10^-2 to 10^2 of their unit, either sign: more than any rig does, less than any overflow."""
CHUNK = 64
"""Searched values looked at together: all of them with all samples would not fit into memory."""
ROUNDING = 1e-9
"""Of numbers of order one, far more than a few hundred operations leave."""


def require_felt(effect: FormulaEffect, where: str) -> None:
    """Raise InputError unless the effect vanishes at nominal values, and each amplitude has a slope there.

    Screening takes the derivative at the nominal values: an amplitude that enters squared would never be found.
    """
    space = effect.spaces[0]
    try:
        value, slopes = _tried(effect, space)
    except (KeyError, TypeError, ValueError):  # SymPy has made of it what CasADi does not have
        remedy = "keep arguments of atan2, abs, min and max from being constant or complex"
        place = f"{where}: {effect.definition.key}"
        raise InputError(what="a function of it has no counterpart in code", where=place, remedy=remedy) from None
    keys = [f"{effect.definition.key}.{name}" for name, _ in effect.definition.formulas]
    finite = np.isfinite(value) & np.isfinite(slopes).all(axis=2)
    for channel, key in enumerate(keys):
        if not finite[:, channel].any():
            remedy = "correct it: a root of something negative, a division by zero, an exp of something large"
            raise InputError(what="it is finite nowhere", where=f"{where}: {key}", remedy=remedy)
        if np.abs(value[finite[:, channel], channel]).max() > ROUNDING:
            what = "it does not vanish when the parameters that are not searched are at their nominal values"
            remedy = "multiply it by an amplitude, or state the nominal values"
            raise InputError(what=what, where=f"{where}: {key}", remedy=remedy)
    felt = np.where(finite[:, :, None], np.abs(slopes), 0.0).max(axis=(0, 1))
    for parameter, slope in zip([p for p in effect.parameters(space) if not p.nuisance], felt, strict=True):
        if not slope > 0:
            what = "the effect does not change with it at nominal values, so that no screening can find it"
            remedy = "write the effect in proportion to it, or give it `search` if it only shapes the effect"
            raise InputError(what=what, where=f"{where}: parameters.{parameter.name}", remedy=remedy)


def require_finite(effect: FormulaEffect, space: Space, signals: Signals, samples: int, where: str) -> None:
    """Raise InputError where a recording's signals leave no finite effect, for any of the values that are searched.

    `signals` are those of the recording by name, each (samples,); nothing is said when it lacks one that is needed.
    """
    parameters = effect.parameters(space)
    emitted = _emitted(effect, space, tuple(p.name for p in parameters))
    if not set(emitted.inputs) <= set(signals):
        return
    amplitudes = tuple(i for i, p in enumerate(parameters) if not p.nuisance)
    grid = [[values.get(p.name, p.nominal) for p in parameters] for values in effect.nuisance_grid(Extent())]
    for first in range(0, len(grid), CHUNK):
        slopes = emitted.slopes(signals, np.array(grid[first : first + CHUNK]), amplitudes, samples)
        wrong = np.argwhere(~np.isfinite(slopes))
        if len(wrong):
            sample, formula, trial, _ = wrong[0]
            key = f"{effect.definition.key}.{effect.definition.formulas[formula][0]}"
            at = ", ".join(
                f"{p.name} = {v:.4g}" for p, v in zip(parameters, grid[first + trial], strict=True) if p.nuisance
            )
            what = f"{effect.id}: {key} is not finite at sample {sample + 1}{' with ' * bool(at)}{at}"
            remedy = "keep roots and quotients away from there, or search other values"
            raise InputError(what=what, where=where, remedy=remedy)


def _tried(effect: FormulaEffect, space: Space) -> tuple[Array, Array]:
    """Values (places, formulas) and slopes (places, formulas, amplitudes) at nominal amplitudes, all else random."""
    amplitudes = [p for p in effect.parameters(space) if not p.nuisance]
    emitted = _emitted(effect, space, tuple(p.name for p in amplitudes))
    return emitted.tangent(_places(effect, emitted.inputs), np.array([p.nominal for p in amplitudes]), PLACES)


def _emitted(effect: FormulaEffect, space: Space, names: tuple[str, ...]) -> Emitted:
    """The formulas as functions of the parameters named; other parameters are inputs, like signals."""
    size = len(space.channels)
    chain = rigid_chain(space, gravity=0.0, sign=(1,) * size, zero=sp.zeros(size, 1), mounting=sp.eye(3))
    known = {p.name: sp.Symbol(p.name, real=True) for p in effect.parameters(space)}
    added, _ = formulas_of(effect.definition).values(chain, known)
    expressions, symbols = sp.Matrix(list(added.values())), tuple(known[name] for name in names)
    inputs = tuple(sorted(s.name for s in expressions.free_symbols - set(symbols)))
    return Emitted.of(expressions, inputs, symbols)


def _places(effect: FormulaEffect, inputs: tuple[str, ...]) -> dict[str, Array]:
    rng, searched = np.random.default_rng(0), dict(effect.definition.search)
    found = {}
    for name in inputs:
        size = 10.0 ** rng.uniform(-DECADES, DECADES, PLACES)
        found[name] = size * rng.choice([-1.0, 1.0], PLACES)
        if name in searched:
            found[name] = rng.choice(np.array(searched[name]), PLACES)
    if "time" in found:
        found["time"] = np.abs(found["time"])
    turn = rng.normal(size=(4, PLACES))
    return found | dict(zip(("qx", "qy", "qz", "qw"), turn / np.linalg.norm(turn, axis=0), strict=True))
