"""The manual's pages: links lead somewhere, every effect and every public name has its place, commands exist.

`make docs` builds it, and executes its cells; what is here takes no builder.
"""

from __future__ import annotations

import ast
import inspect
import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import truewrench as tw
from docs.generator.command_page import command_page
from docs.generator.docstring_text import restructured
from docs.generator.effect_page import described, sentence
from docs.generator.terminal import terminal
from estimation.budget_table import Statement
from modeling.chain.model import planar, spatial
from modeling.effects import CATALOGUE, catalogue
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.places import ROOT, URDF
from truewrench.command_line import COMMANDS
from truewrench.simulated_rig import HIDDEN_EFFECTS

DOCS = ROOT / "docs"
PAGES = sorted(page for page in DOCS.rglob("*.md") if not {"generated", "generator"} & set(page.parts))
IDS = [effect.id for effect in CATALOGUE]
GENERATED = {
    *(f"generated/catalogue/{name}.md" for name in [*IDS, "index"]),
    *(f"generated/notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")),
    "generated/notebooks/index.md",
    "generated/commands.md",
}
LABELS = {*(f"effect-{name}" for name in IDS), "catalogue", "notebooks", "commands"}
EXECUTED = "file_format: mystnb"


def names_in_reference() -> list[str]:
    """Public names that the pages of the reference list, as often as they do."""
    text = "\n".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md"))
    return re.findall(r"^\.\. auto(?:function|class):: truewrench\.(\w+)$", text, flags=re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith("#"):
            assert target[1:] in LABELS, target
            continue
        place = (page.parent / target.partition("#")[0]).resolve()
        assert place.exists() or place.relative_to(DOCS).as_posix() in GENERATED, target


def test_every_page_is_in_a_table_of_contents() -> None:
    listed = set()
    for page in PAGES:
        for entries in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL):
            names = [line for line in entries.splitlines() if line and not line.startswith(":")]
            listed |= {(page.parent / name).relative_to(DOCS).as_posix() for name in names}
    own = {page.relative_to(DOCS).with_suffix("").as_posix() for page in PAGES} - {"index"}
    generated = {name.removesuffix(".md") for name in GENERATED if name.count("/") == 1 or name.endswith("index.md")}
    assert listed == own | generated


def test_every_public_name_is_in_the_reference_once() -> None:
    public = {n for n in import_module("truewrench").__all__ if not inspect.ismodule(getattr(tw, n))}
    assert sorted(names_in_reference()) == sorted(public)


def test_results_in_the_reference_exist() -> None:
    text = (DOCS / "reference" / "results.md").read_text(encoding="utf-8")
    names = re.findall(r"^\.\. autoclass:: ([\w.]+)\.(\w+)$", text, flags=re.MULTILINE)
    assert len(names) > 10
    for module, name in names:
        assert inspect.isclass(getattr(import_module(module), name))


def test_every_effect_can_be_described_and_simulated() -> None:
    """The page shows how the effect is seen and provoked, and pictures of a rig that hides it."""
    assert set(IDS) <= set(HIDDEN_EFFECTS)
    models = {Space.PLANE: planar(Rig(link_lengths=(1.0, 0.97, 0.4))), Space.SPACE: spatial()}
    for effect in catalogue():
        page = described(effect, models[effect.spaces[0]])
        assert f"`{effect.id}`" not in str(page["docstring"])
        for target in re.findall(r"\(#([\w-]+)\)", f"{page['confused']}{page['advice']}"):
            assert target in LABELS
        for space, table in page["parameters"]:  # type: ignore[attr-defined]
            assert table.count("\n") >= 2, space


def test_a_sentence_links_the_effects_that_it_names() -> None:
    assert sentence("sensor_lag, in slow motion") == "[`sensor_lag`](#effect-sensor_lag), in slow motion."
    assert sentence("a cable") == "A cable."


def test_every_command_has_its_section() -> None:
    headings = re.findall(r"^## (\S+)$", command_page(), flags=re.MULTILINE)
    assert len(headings) == len(COMMANDS)
    used = {
        name for page in PAGES for name in re.findall(r"(?<!import )\btruewrench ([a-z]+)\b(?= )", "".join(_code(page)))
    }
    assert used <= set(headings)


def _code(page: Path) -> list[str]:
    """Blocks of code of a page."""
    return re.findall(r"^```\{?[\w-]*\}?\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_cells_are_python(page: Path) -> None:
    """What they import is there; and a page with cells has the heading that makes the builder execute them."""
    text = page.read_text(encoding="utf-8")
    cells = re.findall(r"^```\{code-cell\}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    assert bool(cells) == (EXECUTED in text)
    for cell in cells:
        tree = ast.parse("\n".join(line for line in cell.splitlines() if not line.startswith(":")))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                module = import_module(str(node.module))
                assert all(hasattr(module, alias.name) for alias in node.names), node.module


def test_the_rig_file_of_the_formats_is_one() -> None:
    text = (DOCS / "guide" / "file_formats.md").read_text(encoding="utf-8")
    rig, capsules, torques, weighed, stated = re.findall(r"^```toml\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    assert Rig.from_data(tomllib.loads(rig)).link_lengths == (1.0, 0.97, 0.4)
    arm = {"robot": {"urdf": str(URDF / "elbow.urdf"), "sensor_frame": "tool0"}}
    workspace = Rig.from_data(arm | tomllib.loads(capsules)).workspace
    assert workspace is not None
    assert [capsule.joint for capsule in workspace.capsules] == [6]
    tables = tomllib.loads(torques)
    tables["limits"] |= {"position": [2.0] * 6, "velocity": [1.0] * 6, "acceleration": [2.0] * 6}
    limits = Rig.from_data(arm | tables).limits
    assert limits is not None
    assert limits.torque is not None
    assert limits.torque.allowed[:, 1].tolist() == [150, 150, 150, 28, 28, 28]
    ((name, load),) = Rig.from_data(tomllib.loads(weighed)).loads
    assert (name, load.mass, load.at) == ("two_kg.csv", 2.0, (0.0, 0.0, 0.05))
    assert len(Statement.of(tomllib.loads(stated), "budget").contributions) == 3


def test_a_terminal_shows_what_ran(capsys: pytest.CaptureFixture[str]) -> None:
    terminal("truewrench effects sensor_lag", lines=1)
    assert capsys.readouterr().out.startswith("$ truewrench effects sensor_lag\nsensor_lag: ")
    terminal("truewrench effects sensor_leg", exit_code=2)
    assert "error: " in capsys.readouterr().out
    with pytest.raises(RuntimeError, match="exit code 2"):
        terminal("truewrench effects sensor_leg")


def test_docstrings_keep_their_examples_and_sections() -> None:
    lines = ["A |v|.", "", "theta  unknowns", "       of the fit", "noise  per |x|", "", ">>> abs(-1) | 0", "1"]
    assert restructured(lines) == [
        r"A \|v\|.", "", "- ``theta``: unknowns", "  of the fit", r"- ``noise``: per \|x\|", "", ">>> abs(-1) | 0", "1",
    ]  # fmt: skip
    numpydoc = ["Parameters", "----------", "a  b", "    c"]
    assert restructured(numpydoc) == numpydoc
