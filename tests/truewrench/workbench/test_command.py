"""`truewrench workbench`: what cannot be served is one line, and exit code 2."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from truewrench.command_line import main


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["missing.csv"], "missing.csv"), (["--rig", "missing.toml"], "missing.toml"), (["--port", "70000"], "--port")],
)
def test_bad_arguments_are_one_line(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["workbench", "--no-browser", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_port_that_is_taken_is_said(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main(["workbench", "--no-browser", "--port", str(taken.getsockname()[1])]) == 2
    assert "give --port another number" in capsys.readouterr().err
