"""plotly.js inside the page: compressed, unpacked by the browser at the first zoom, so that nothing is fetched.

The whole library is 4.8 MB, compressed and as text 2.0 MB; its smaller bundles are not in the Python package.
"""

from __future__ import annotations

import gzip
from base64 import b64encode
from functools import cache
from hashlib import sha256
from importlib.resources import files


@cache
def packed_plotly() -> str:
    """plotly.js, gzipped, in base64."""
    from plotly.offline import get_plotlyjs

    return b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode()


@cache
def loader_script() -> str:
    """The script that draws a zoomable figure when its button is pressed."""
    return (files("truewrench") / "templates" / "zoom.js").read_text(encoding="utf-8").strip()


def script_hash(script: str) -> str:
    """Hash by which the page's security policy knows the script; no other runs."""
    return f"sha256-{b64encode(sha256(script.encode()).digest()).decode()}"
