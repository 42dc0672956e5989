"""Every effect of the catalogue against every check that it has to keep: `python -m benchmarks.conformance`.

The checks are those of the tests (tests/modeling/effects); a failing one says why below the table. `unseen` are the
parameters of an effect that the case's motion does not show, as the refit itself says; `-` is where a check does not
apply: no simulated rig has the effect, or no code is emitted for what belongs to one recording.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from estimation.fit import Fit
from modeling.table import Table
from tests.modeling.effects.cases import CASES, Case
from tests.modeling.effects.checks import CHECKS, c_agrees, emitted
from tests.modeling.effects.same_physics import same_physics_as_mujoco, simulated_too

SPACES = {"PLANE": "plane", "SPACE": "six axes"}


@dataclass(frozen=True)
class Outcome:
    """What a check said: a word for the table, and the reason where it fails."""

    word: str
    reason: str = ""


def outcome(check: Callable[[Case], object], case: Case) -> Outcome:
    """The check on one case."""
    try:
        found = check(case)
    except AssertionError as failure:
        return Outcome("FAILS", str(failure).strip().partition("\n")[0])
    if isinstance(found, Fit) and found.unidentifiable:
        names = [name.partition(".")[2] for direction in found.unidentifiable for name in direction.names]
        return Outcome(f"unseen: {', '.join(names)}")
    return Outcome("yes")


def row(case: Case) -> dict[str, Outcome]:
    """Every check on one case, by the head of its column."""
    applied = {name: check for name, check in CHECKS.items() if emitted(case) or check is not c_agrees}
    found = dict.fromkeys(CHECKS, Outcome("-")) | {name: outcome(check, case) for name, check in applied.items()}
    return found | {"MuJoCo": outcome(same_physics_as_mujoco, case) if simulated_too(case) else Outcome("-")}


def main() -> None:
    """Print the table, and the reasons of what fails."""
    rows = {case: row(case) for case in CASES}
    words = [[c.effect.id, SPACES[c.space.name], *(o.word for o in r.values())] for c, r in rows.items()]
    print(Table.of(("effect", "space", *CHECKS, "MuJoCo"), words))
    for case, outcomes in rows.items():
        for name, found in outcomes.items():
            if found.reason:
                print(f"{case}, {name}: {found.reason}")


if __name__ == "__main__":
    main()
