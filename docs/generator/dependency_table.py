"""Table of the packages that truewrench needs, with their licences: `python -m docs.generator.dependency_table`."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from modeling.table import Table

ROOT = Path(__file__).parents[2]
FILE = ROOT / "DEPENDENCIES.md"
EXTRAS = ("logs", "workbench", "survey", "simulation", "xarray")
"""Beside what every installation has; the tools of `docs` and `development` are not listed."""
LONGEST_LICENCE = 60
"""Characters of a licence's name; longer ones are the licence itself."""
HEAD = """# Licences of dependencies

Packages that an installation of truewrench brings with it, directly or by what they need in turn, and the licence that
each states in its metadata. truewrench itself is under the Apache License 2.0 (file LICENSE). None of them is part
of the wheel. Reports that zoom contain BokehJS, which comes with Bokeh under the same licence.

Lower bounds in pyproject.toml are what `make oldest` installs and tests: SciPy 1.15 and matplotlib 3.10 are the first
that have what is called, SymPy 1.14 the first whose functions of NumPy compare numbers with arrays.

Written by `python -m docs.generator.dependency_table`; a test compares it with what is installed.
"""


def dependency_file() -> str:
    """The whole file."""
    return f"{HEAD}\n{dependency_table().to_markdown()}\n"


def dependency_table() -> Table:
    """Name, licence, and the extra that a package belongs to."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = dict.fromkeys(closure(project["dependencies"]), "always")
    for extra in EXTRAS:
        for name in closure(project["optional-dependencies"][extra]):
            needed.setdefault(name, f"extra {extra}")
    return Table.of(
        ("package", "licence", "needed"), [(n, licence(distribution(n)), needed[n]) for n in sorted(needed)]
    )


def closure(requirements: Iterable[str]) -> dict[str, None]:
    """Canonical names of the installed packages that these requirements lead to."""
    found: dict[str, None] = {}
    waiting = [Requirement(text) for text in requirements]
    while waiting:
        name = canonicalize_name(waiting.pop().name)
        if name not in found and (installed := _installed(name)):
            found[name] = None
            waiting += _needed(installed)
    return found


def _installed(name: str) -> Distribution | None:
    try:
        return distribution(name)
    except PackageNotFoundError:  # for another platform
        return None


def _needed(installed: Distribution) -> Iterator[Requirement]:
    """What it needs on this platform, without extras."""
    for text in installed.requires or ():
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield requirement


def licence(installed: Distribution) -> str:
    """The licence by its expression, else by its name where that is short, else by its classifier."""
    expressions, names, classifiers = (
        [str(value) for value in installed.metadata.get_all(key) or ()]
        for key in ("License-Expression", "License", "Classifier")
    )
    named, classifiers = "".join(names[:1]), [c for c in classifiers if c.startswith("License ::")]
    if expressions:
        return expressions[0]
    if classifiers and not classifiers[0].endswith("OSI Approved"):
        return classifiers[0].rpartition(" :: ")[2]
    return named if 0 < len(named) <= LONGEST_LICENCE and "\n" not in named else "not stated"


if __name__ == "__main__":
    FILE.write_text(dependency_file(), encoding="utf-8")
