"""Plugins: effects, log readers and code targets of packages that are installed beside the project."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

EFFECTS, READERS, TARGETS = "truewrench.effects", "truewrench.readers", "truewrench.targets"
"""Groups of entry points, as a package's metadata call them."""
LONGEST_FAULT = 120
"""Characters of a plugin's own message that are repeated."""


@dataclass(frozen=True)
class Plugin:
    """One entry point of a package.

    loaded   what it names; None where it is not used
    fault    why it is not used; empty where it is
    """

    group: str
    name: str
    package: str
    version: str
    loaded: Any = None
    fault: str = ""

    def __str__(self) -> str:
        """Its name, and the package with its version."""
        unused = f", not used: {self.fault}" if self.fault else ""
        return f"{self.name} of {self.package} {self.version}{unused}"


@cache
def plugins(group: str, checked: Callable[[Any], Any]) -> tuple[Plugin, ...]:
    """The entry points of a group, each as `checked` makes it, which may raise: one that fails is not used.

    A package that somebody else wrote may fail in any way, and no command with it.
    """
    from importlib.metadata import entry_points  # slow, and where there is nothing to load in vain

    found = []
    for entry in entry_points(group=group):
        package = (entry.dist.name, entry.dist.version) if entry.dist is not None else ("unknown", "")
        try:
            found.append(Plugin(group, entry.name, *package, loaded=checked(entry.load())))
        except Exception as error:
            fault = " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST_FAULT]
            found.append(Plugin(group, entry.name, *package, fault=fault))
    FOUND.extend(found)
    return tuple(found)


FOUND: list[Plugin] = []
"""What was looked for so far: of this process, which is told what is not used once."""
