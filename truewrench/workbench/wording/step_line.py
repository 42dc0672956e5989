"""Line of the last step, which stays in sight: what was changed, and what became of the error."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from diagnosis.study import Study

ERRORS = ("error / noise floor", "held out")
"""Columns of a study's table that the line repeats."""


@dataclass(frozen=True)
class StepLine:
    """The last step of a study.

    done    what was done: `added sensor_lag`
    before  its errors before, as text by column of the study's table; empty for the first model
    after   those of the current model
    """

    done: str = ""
    before: tuple[tuple[str, str], ...] = ()
    after: tuple[tuple[str, str], ...] = ()

    def then(self, done: str, study: Study) -> StepLine:
        """The line after another step."""
        return StepLine(done, self.after, errors_of(study))

    def words(self) -> str:
        """As HTML, such as `added sensor_lag: error / noise floor 5.28 → 0.551, held out 4.78 → 0.829`."""
        known = dict(self.before) if self.before != self.after else {}
        errors = Markup(", ").join(
            Markup("{} {}<b>{}</b>").format(name, f"{known[name]} → " if name in known else "", now)
            for name, now in self.after
        )
        return Markup("{}: {}").format(self.done, errors)


def errors_of(study: Study) -> tuple[tuple[str, str], ...]:
    """The largest error over noise floor of the current model, fitted and held out, as the table of steps has it."""
    table = study.table
    last = zip(table.columns, table.rows[-1], strict=True)
    return tuple((c.heading, c.text(value)) for c, value in last if c.heading in ERRORS)
