"""Settings of all tests: one thread of linear algebra per process, as two processes share two cores; seeds are fixed.

Garbage is collected after a hundred thousand new objects: after each seven hundred, Python's own, it took a fortieth
of the time, most of it to look through what lives to the end. Until the tests are collected, all that is made lives to
the end, so that nothing is looked through.

What is derived is kept between tests and runs, and away from the user's: entries are named by the source that they
follow from, so that a test of an edited derivation derives.
"""

import gc
import os
from collections.abc import Generator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from truewrench.files import output

settings.register_profile("seeded", derandomize=True, max_examples=60)
settings.load_profile("seeded")
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
KEPT = Path(__file__).resolve().parents[1] / ".pytest_cache" / "derivations"
os.environ.setdefault("TRUEWRENCH_CACHE", str(KEPT))
gc.set_threshold(100_000, 20, 20)
output.FIRST_LINE = 3600.0  # what a busy machine makes long says nothing of it

Made = pytest.Item | pytest.Collector | list[pytest.Item | pytest.Collector] | None
"""What pytest makes of a name of a module or class."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files without a long test where only those are asked for: one file in six has any."""
    only_long = config.option.markexpr == "long" and collection_path.name.startswith("test_")
    return True if only_long and not _has_long(collection_path) else None


@cache
def _has_long(path: Path) -> bool:
    """Whether a file marks a test as long."""
    return "mark.long" in path.read_text(encoding="utf-8")


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem(collector: pytest.Collector) -> Generator[None, Made, Made]:
    """Refuse a long test that `make long` would not find."""
    made = yield
    for item in made if isinstance(made, list) else []:
        if item.get_closest_marker("long") and not _has_long(collector.path):
            raise collector.CollectError(f"{item.nodeid} is long, but its file does not hold the text 'mark.long'")
    return made


@pytest.hookimpl(trylast=True)  # when the other tier is left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put a file's tests of one `case` beside each other: they share what was made of it, which a process keeps.

    The longest ones, by `long(seconds=..)`, come first of each half, as each of two processes begins with a half: one
    that comes last would leave the other process idle.
    """
    first: dict[tuple[Path, object], int] = {}
    places: dict[pytest.Item, int] = {}
    for number, item in enumerate(items):
        drawn = getattr(item, "callspec", None)  # of parametrised tests
        case = drawn.params.get("case") if drawn else None
        places[item] = first.setdefault((item.path, case), number) if isinstance(case, str) else number
    items.sort(key=places.__getitem__)
    longest = sorted((item for item in items if _seconds(item)), key=_seconds, reverse=True)
    others = [item for item in items if not _seconds(item)]
    middle = max(0, len(items) // 2 - len(longest[::2]))
    items[:] = [*longest[::2], *others[:middle], *longest[1::2], *others[middle:]]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leave what collecting makes out of the garbage collector's rounds: a million objects that live to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _seconds(item: pytest.Item) -> float:
    """What a test states of the processor time that it takes, else 0."""
    mark = item.get_closest_marker("long")
    return 0.0 if mark is None else float(mark.kwargs.get("seconds", 0.0))
