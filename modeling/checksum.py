"""Checksum of stored data: a first line that shows whether the rest is what was written."""

from __future__ import annotations

import hashlib


def sha256_of(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def with_checksum(content: bytes) -> bytes:
    """The content below a line with its SHA-256."""
    return sha256_of(content).encode() + b"\n" + content


def verified(stored: bytes) -> bytes | None:
    """The content of what `with_checksum` made; None where either was changed or cut."""
    checksum, _, content = stored.partition(b"\n")
    return content if checksum == sha256_of(content).encode() else None
