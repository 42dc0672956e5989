"""Text summary of a survey."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from estimation.fit import table
from truewrench.surveying.change_detection import significant_changes
from truewrench.surveying.survey_row import SurveyRow


def survey_text(rows: Sequence[SurveyRow], diagnosed: int, verdicts: Mapping[str, int]) -> str:
    """Counts of verdicts and of effects added, significant changes, and errors."""
    count = len(rows)
    known = count - diagnosed
    again = f", {known} of them by an earlier run" if known else ""
    parts = [f"{count} recording{'' if count == 1 else 's'}{again}"]
    parts.append(table(("verdict", "recordings"), [(v, str(n)) for v, n in verdicts.items()]))
    added = Counter(effect for row in rows for effect in row.outcome.added)
    if added:
        parts.append(table(("effect", "added to"), [(effect, str(n)) for effect, n in added.most_common()]))
    parts += [f"{change}." for change in significant_changes(rows)]
    parts += [f"{row.file}: {row.outcome.error}" for row in rows if row.outcome.error]
    return "\n\n".join(parts)
