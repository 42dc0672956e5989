"""Source: the text of a formula and what it is called, so that a refusal can name the column at fault."""

from __future__ import annotations

from dataclasses import dataclass

from modeling.errors import InputError


@dataclass(frozen=True)
class Source:
    """A formula's text; `where` names it (file, effect and key) in a refusal."""

    text: str
    where: str = "formula"

    def refusal(self, column: int, what: str, remedy: str) -> InputError:
        """An error about the character at `column`, counted from 1."""
        return InputError(what=what, where=f"{self.where}, column {column}", remedy=remedy)
