"""A package beside the project: a propeller's thrust, a log with its own head, a language, and two that are broken."""

from __future__ import annotations

import numpy as np

from estimation.reading.log_reader import LogReader, LogTable, SourceFile
from modeling.codegen.code_target import CodeTarget
from modeling.codegen.fitted_model import FittedModel, RigidToolRegressor
from modeling.effects.loads import ViscousDrag


class Thrust(ViscousDrag):
    """A drag under another name: what a package adds need be no new physics to be found."""

    id = "thrust"
    title = "thrust of a propeller"


class Headed(LogReader):
    """Text of numbers behind a line `EXAMPLE time fx ..`."""

    title = "example"

    def recognises(self, source: SourceFile) -> bool:
        """By its first word."""
        return source.head.startswith(b"EXAMPLE ")

    def tables(self, source: SourceFile) -> list[LogTable]:
        """One table."""
        lines = source.path.read_text(encoding="utf-8").splitlines()
        rows = np.array([[float(cell) for cell in line.split()] for line in lines[1:]])
        columns = dict(zip(lines[0].split()[1:], rows.T, strict=True))
        return [LogTable(name=source.name, kind="example", columns=columns)]


class Broken(LogReader):
    """Fails on whatever it is asked."""

    title = "broken"
    rank = -10

    def recognises(self, source: SourceFile) -> bool:
        """Raises."""
        raise RuntimeError("no")

    def tables(self, source: SourceFile) -> list[LogTable]:
        """Never called."""
        raise RuntimeError("no")


class Counting(CodeTarget):
    """How many inputs and parameters there are."""

    name = "count"
    suffix = ".txt"
    sampled = False

    def regressor(self, base: RigidToolRegressor, source: str) -> str:
        """One line."""
        return f"the regressor of {base.space.name}\n"

    def model(self, fitted: FittedModel, source: str) -> str:
        """One line."""
        return "a model\n"


NO_EFFECT = 3
