"""Text of a formula with its location, for error messages that name the column."""

from __future__ import annotations

from dataclasses import dataclass

from modeling.errors import InputError


@dataclass(frozen=True)
class FormulaSource:
    """A formula's text; `where` is its location (file, effect and key) in error messages."""

    text: str
    where: str = "formula"

    def error(self, column: int, what: str, remedy: str) -> InputError:
        """An error about the character at `column`, counted from 1."""
        return InputError(what=what, where=f"{self.where}, column {column}", remedy=remedy)
