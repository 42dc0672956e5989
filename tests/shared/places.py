"""Folders that tests read: the repository, recordings beside it, arms, certified data."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("TRUEWRENCH_DATA") or ROOT.parent / "shared" / "data")
"""Measured and simulated recordings, which are no part of the repository: tests of them are skipped without."""
URDF = Path(__file__).parent / "urdf"
NIST = Path(__file__).parent / "nist"
"""The Statistical Reference Datasets (StRD) of NIST: data, certified values and their digits."""
