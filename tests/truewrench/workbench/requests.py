"""Requests to a workbench: of a browser for a path, and of a page to open a recording."""

from __future__ import annotations

from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from truewrench.files.demonstration import rig_text
from truewrench.simulated_rig import PlanarRig, ViscousDrag, simulate, write_recording


def answer(address: str, path: str = "", method: str = "GET", body: str = "", **headers: str) -> tuple[int, str]:
    """Status and text of a request to a path below the address, its headers with `_` for `-`."""
    response, text = answered(address, path, method, body, **headers)
    return response.status, text


def answered(
    address: str, path: str = "", method: str = "GET", body: str = "", **headers: str
) -> tuple[HTTPResponse, str]:
    """The response, with its headers, and its text."""
    parts = urlsplit(address)
    connection = HTTPConnection(str(parts.hostname), parts.port, timeout=30)
    connection.putrequest(method, parts.path + path if not path.startswith("/") else path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders(body.encode("latin-1"))
    response = connection.getresponse()
    text = response.read().decode(errors="replace")
    connection.close()
    return response, text


def opening(folder: Path, hostile: str = "") -> dict[str, Any]:
    """Request to open a recording of a rig with a drag; `hostile` names a column more."""
    rig = PlanarRig()
    frame = simulate(rig, rig.random_motion(seed=1), hidden=[ViscousDrag()], repeats=4, samples_per_period=150, seed=1)
    if hostile:
        frame[hostile] = range(len(frame))
    (folder / "rig.toml").write_text(rig_text(rig), encoding="utf-8")
    write_recording(frame, folder / "train.csv")
    return {"do": "open", "recordings": [str(folder / "train.csv")], "rig": str(folder / "rig.toml")}
