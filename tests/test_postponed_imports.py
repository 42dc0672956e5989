"""What commands import without using it is loaded with its first use, and then it is all there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys
from truewrench.postponed_imports import POSTPONED, postpone_imports

{prepared}
import scipy.fft
import numpy

print("unittest" in sys.modules, all(name in sys.modules for name in POSTPONED))
print(type(sys.modules["pydoc"]).__name__)
numpy.testing.assert_allclose([1.0], [1.0])
print("unittest" in sys.modules, numpy.f2py.__file__.endswith("__init__.py"))
"""


def printed(prepared: str) -> list[str]:
    """What the program prints in a process of its own."""
    command = [sys.executable, "-c", PROGRAM.format(prepared=prepared)]
    root = Path(__file__).parents[1]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.splitlines()


def test_a_module_is_loaded_with_its_first_use() -> None:
    """`unittest` is what `numpy.testing` imports."""
    assert printed("postpone_imports()\npostpone_imports()") == ["False True", "_LazyModule", "True True"]


def test_without_postponing_scipy_loads_it() -> None:
    """As long as this holds, postponing is worth it."""
    assert printed("") == ["True True", "module", "True True"]
