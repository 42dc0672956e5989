"""Freed memory kept by the process for its next arrays, instead of returned to the system."""

from __future__ import annotations

import sys

M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD = -1, -2, -3
"""Parameters of `mallopt` (malloc.h of the GNU C library)."""
KEPT = 256 << 20
"""Free bytes at the end of the heap beyond which they are returned."""
GROWTH = 64 << 20
"""Bytes by which the heap grows; pages that are never written to stay without memory."""
LARGEST_IN_HEAP = 32 << 20
"""Bytes from which an array is mapped by itself and unmapped when freed, the largest that the library accepts."""


def keep_freed_memory() -> None:
    """Let this process and its forked copies reuse freed memory; without the GNU C library nothing changes.

    A diagnosis allocates and frees arrays of megabytes by the thousand. By default each is returned to the system
    and mapped again, zeroed page by page: up to a fifth of the CPU time. The setting holds for the whole process, so
    a command makes it, not a function of the library.
    """
    if not sys.platform.startswith("linux"):
        return
    from ctypes import CDLL

    mallopt = getattr(CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST_IN_HEAP)
        mallopt(M_TRIM_THRESHOLD, KEPT)
        mallopt(M_TOP_PAD, GROWTH)
