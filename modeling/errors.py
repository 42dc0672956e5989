"""What goes wrong, said in one line that a person can act on."""

from __future__ import annotations

from functools import partial


class TruewrenchError(Exception):
    """Base of every error that this project raises on purpose."""


class InputError(TruewrenchError):
    """Something that a user gave cannot be used: what is wrong with it, where it stands, how to mend it."""

    def __init__(self, *, what: str, where: str, remedy: str) -> None:
        self.what, self.where, self.remedy = (" ".join(part.split()) for part in (what, where, remedy))
        super().__init__(f"{self.where}: {self.what}; {self.remedy}")

    def __reduce__(self) -> tuple[object, ...]:
        # Keyword-only arguments do not survive the default pickling, and workers of a pool send errors back.
        return partial(InputError, what=self.what, where=self.where, remedy=self.remedy), ()
