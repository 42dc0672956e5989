"""Folders that tests read: the repository, recordings beside it, arms, certified data."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("TRUEWRENCH_DATA") or ROOT.parent / "shared" / "data")
"""Recordings, which are no part of the repository: at TRUEWRENCH_DATA, or else at ../shared/data beside it."""
AIS2202 = DATA / "ais2202"
"""Measured recordings of a KUKA LBR Med 14 with an ATI Gamma and an unknown tool (Skrede, Zenodo 11096791)."""
URDF = Path(__file__).parent / "urdf"
NIST = Path(__file__).parent / "nist"
"""The Statistical Reference Datasets (StRD) of NIST: data, certified values and their digits."""


def needs(folder: Path) -> pytest.MarkDecorator:
    """Skip tests where a folder of recordings is missing."""
    return pytest.mark.skipif(not folder.is_dir(), reason=f"no recordings at {folder}: set TRUEWRENCH_DATA")
