"""Summary: a survey in a few lines of text."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from estimation.fit import table
from truewrench.surveying.change import changes_of

if TYPE_CHECKING:
    from truewrench.surveying.survey import Survey


def survey_text(survey: Survey) -> str:
    """How many recordings have each verdict, which effects were added how often, what changed, and every error."""
    count = len(survey.rows)
    known = count - survey.diagnosed
    again = f", {known} of them by an earlier run" if known else ""
    parts = [f"{count} recording{'' if count == 1 else 's'}{again}"]
    parts.append(table(("verdict", "recordings"), [(v, str(n)) for v, n in survey.verdicts.items()]))
    added = Counter(effect for row in survey.rows for effect in row.outcome.added)
    if added:
        parts.append(table(("effect", "added to"), [(effect, str(n)) for effect, n in added.most_common()]))
    parts += [f"{change}." for change in changes_of(survey.rows)]
    parts += [f"{row.file}: {row.outcome.error}" for row in survey.rows if row.outcome.error]
    return "\n\n".join(parts)
