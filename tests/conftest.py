"""Settings of all tests: one thread of linear algebra per process, as two processes share two cores; seeds are fixed.

What is derived is kept between tests and runs, and away from the user's: entries are named by the source that they
follow from, so that a test of an edited derivation derives.
"""

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("seeded", derandomize=True, max_examples=60)
settings.load_profile("seeded")
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
KEPT = Path(__file__).resolve().parents[1] / ".pytest_cache" / "derivations"
os.environ.setdefault("TRUEWRENCH_CACHE", str(KEPT))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put a file's tests of one `case` beside each other: they share what was made of it, which a process keeps."""
    first: dict[tuple[Path, object], int] = {}
    places: dict[pytest.Item, int] = {}
    for number, item in enumerate(items):
        drawn = getattr(item, "callspec", None)  # of parametrised tests
        case = drawn.params.get("case") if drawn else None
        places[item] = first.setdefault((item.path, case), number) if isinstance(case, str) else number
    items.sort(key=places.__getitem__)
