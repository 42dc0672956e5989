"""Store: outcomes kept one by one as they come, so that a survey goes on where it stopped."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from truewrench.output import replacing
from truewrench.surveying.outcome import Outcome


@dataclass(frozen=True)
class OutcomeStore:
    """A folder with one small JSON file for each outcome, named by its fingerprint."""

    folder: Path

    def get(self, key: str | None) -> Outcome | None:
        """The outcome of that fingerprint; None where there is none, or its file is damaged."""
        if key is None:
            return None
        try:
            return _layout().validate_json(self._path(key).read_bytes())
        except (OSError, ValidationError):
            return None

    def put(self, key: str, outcome: Outcome) -> None:
        """Keep an outcome: written beside its place and renamed into it.

        Raises InputError when it cannot be written.
        """
        with replacing(self._path(key)) as path:
            path.write_bytes(_layout().dump_json(outcome))

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.json"


@cache
def _layout() -> TypeAdapter[Outcome]:
    return TypeAdapter(Outcome)
