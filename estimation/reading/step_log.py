"""Step log: collects the steps of a reading; in a strict reading the first one that mends is an error."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from estimation.recordings.reading_report import Assumption, ReadingStep, Span, StepKind
from modeling.errors import InputError


@dataclass
class StepLog:
    """Steps in the order in which they were taken; `held` and `assumptions` as of the report."""

    strict: bool = False
    steps: list[ReadingStep] = field(default_factory=list)
    held: dict[str, int] = field(default_factory=dict)
    assumptions: list[Assumption] = field(default_factory=list)

    def taken(self, what: str, where: str, count: int | None = None, total: int | None = None) -> None:
        """Something was read as it stands, or converted as stated."""
        self.steps.append(ReadingStep(kind=StepKind.TAKEN, what=what, where=where, count=count, total=total))

    def mended(
        self,
        what: str,
        where: str,
        count: int | None = None,
        total: int | None = None,
        at: tuple[Span, ...] = (),
        channels: Iterable[str] = (),
    ) -> None:
        """Samples were changed, moved or left out, `at` these stamps. Raises InputError in a strict reading."""
        step = ReadingStep(
            kind=StepKind.MENDED, what=what, where=where, count=count, total=total, at=at, channels=tuple(channels)
        )
        if self.strict:
            what = str(step).removeprefix(f"{where}: ")
            raise InputError(
                what=f"would have to be mended: {what}", where=where, remedy="leave out --strict to mend it"
            )
        self.steps.append(step)

    def suspicious(
        self,
        what: str,
        where: str,
        count: int | None = None,
        total: int | None = None,
        at: tuple[Span, ...] = (),
        channels: Iterable[str] = (),
    ) -> None:
        """Something is left as it is, and may be wrong, `at` these stamps."""
        step = ReadingStep(
            kind=StepKind.SUSPICIOUS, what=what, where=where, count=count, total=total, at=at, channels=tuple(channels)
        )
        self.steps.append(step)
