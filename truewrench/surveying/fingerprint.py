"""Fingerprint: what an outcome depends on, as one hash: the recording, the rig, the candidates, the code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

LAYOUT = 1
"""Of a stored outcome; another number when its fields change."""
JUDGES = ("modeling", "design", "estimation", "diagnosis")
"""The packages whose code decides what is found."""


def fingerprint(recording: Path, rig: Mapping[str, Any] | None, only: tuple[str, ...] | None) -> str:
    """The SHA-256 of all that the outcome of this recording depends on, in hexadecimal.

    Of the file's name only the ending counts, which says what format it is read as: a renamed recording stays known.
    Raises OSError when the recording cannot be read.
    """
    settings = {"layout": LAYOUT, "code": code_version(), "format": recording.suffix.lower(), "rig": rig, "only": only}
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode("ascii"))
    with recording.open("rb") as stream:
        digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


@cache
def code_version() -> str:
    """A hash of the sources that judge, which also tells apart two checkouts of one version."""
    digest = hashlib.sha256()
    for package in JUDGES:
        spec = find_spec(package)
        for folder in [] if spec is None else spec.submodule_search_locations or []:
            for source in sorted(Path(folder).rglob("*.py")):
                digest.update(source.relative_to(folder).as_posix().encode())
                digest.update(hashlib.sha256(source.read_bytes()).digest())
    return digest.hexdigest()
