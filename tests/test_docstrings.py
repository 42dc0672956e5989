"""Docstrings of the public names: numpydoc sections, the signature's parameters, and examples that run."""

from __future__ import annotations

import doctest
import inspect
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import truewrench as tw
from truewrench.files import demonstration

if TYPE_CHECKING:
    from griffe import DocstringSectionKind

pytest.importorskip("mujoco")

NAMES = sorted(name for name in import_module("truewrench").__all__ if not inspect.ismodule(getattr(tw, name)))
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
LONG = ("calibrate", "discriminate", "report", "study")
"""Examples of more than two seconds."""


@pytest.fixture(scope="module")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rig file and recordings, as `truewrench demo --effect viscous_drag` writes them: the examples read them."""
    folder = tmp_path_factory.mktemp("demo")
    demonstration.record(demonstration.hidden_effect_by_id("viscous_drag"), folder)
    return folder


def sections(name: str) -> dict[DocstringSectionKind, Any]:
    """The sections of a public name's docstring by their kind."""
    from griffe import Docstring, Parser  # slow to import

    text = inspect.getdoc(getattr(tw, name)) or ""
    return {part.kind: part.value for part in Docstring(text, parser=Parser.numpy).parsed}


def signature_names(name: str) -> list[str]:
    """The parameters of a function, or of a class's constructor; none for an exception."""
    thing = getattr(tw, name)
    if inspect.isclass(thing) and issubclass(thing, Exception):
        return []
    return [p.lstrip("*") for p in inspect.signature(thing).parameters]


@pytest.mark.parametrize("name", NAMES)
def test_sections(name: str) -> None:
    from griffe import DocstringSectionKind

    thing, found = getattr(tw, name), sections(name)
    summary = (inspect.getdoc(thing) or "").split("\n")[0]
    assert summary.endswith("."), "the first line is one sentence"
    described = [p.name.lstrip("*") for p in found.get(DocstringSectionKind.parameters, [])]
    assert described == signature_names(name)
    if inspect.isfunction(thing):
        assert DocstringSectionKind.returns in found or DocstringSectionKind.yields in found


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long if n in LONG else []) for n in NAMES])
def test_example(name: str, demo_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example imports `truewrench` alone and works in the demo's folder."""
    monkeypatch.chdir(demo_folder)
    text = inspect.getdoc(getattr(tw, name)) or ""
    test = doctest.DocTestParser().get_doctest(text, {"tw": tw}, name, None, 0)
    assert test.examples, "no example"
    failures: list[str] = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(test, out=failures.append)
    assert not failures, "".join(failures)
