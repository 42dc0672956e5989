"""The benchmarks import what they measure: a rename in the library may not leave them behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py") if path.stem != "__main__")


def test_every_benchmark_imports() -> None:
    program = "\n".join(f"import benchmarks.{name}" for name in MODULES)
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
