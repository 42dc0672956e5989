"""Sine and cosine of the same angle from one tangent, of half the angle."""

from __future__ import annotations

from collections.abc import Collection

from modeling.evaluation.tape import NO_OPERAND, Operation, Tape


def with_half_angles(tape: Tape, angles: Collection[int]) -> Tape:
    """The tape with t = tan(x/2), sin x = 2t / (1 + t²), cos x = (1 - t²) / (1 + t²) for x among `angles`.

    Only an angle of which the tape has both is changed. That is one function of the C library instead of two; with
    AVX-512 NumPy computes tangents eight at once, but sines and cosines one by one. Both are within 2^-52 of their
    exact values, the sine also within 2^-51 of its size.
    """
    operations = tape.operations
    sines, cosines = ({a for name, a, _ in operations if name == wanted} for wanted in ("sin", "cos"))
    both = sines & cosines & set(angles)
    if not both:
        return tape
    half, one, first = tape.first, tape.first + 1, tape.first + 2
    found: list[Operation] = []
    number = list(range(tape.first))
    parts: dict[int, tuple[int, int, int]] = {}

    def value(name: str, a: int, b: int = NO_OPERAND) -> int:
        found.append((name, a, b))
        return first + len(found) - 1

    for name, a, b in operations:
        if name in ("sin", "cos") and a in both:
            if a not in parts:
                tangent = value("tan", value("mul", number[a], half))
                square = value("sq", tangent)
                parts[a] = tangent, square, value("add", square, one)
            tangent, square, denominator = parts[a]
            numerator = value("twice", tangent) if name == "sin" else value("sub", one, square)
            number.append(value("div", numerator, denominator))
        else:
            number.append(value(name, number[a], b if b == NO_OPERAND else number[b]))
    constants = (*tape.constants, 0.5, 1.0)
    return Tape(tape.inputs, tape.parameters, constants, tuple(found), tuple(number[r] for r in tape.results))
