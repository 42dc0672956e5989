"""The notebooks: each runs from the top as it stands, and what it claims in words is so."""

from __future__ import annotations

import ast
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.verdict_rule import RecordVerdict
from tests.shared.places import AIS2202, DATA, ROOT

pytest.importorskip("mujoco")

FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted((FOLDER / "source").glob("*.py"))


def first_diagnosis(names: dict[str, Any]) -> None:
    """The tether is named and was what bent the inertia; the magnet stays unexplained where it hangs."""
    assert names["where"].comparison.lack_of_fit < 1e-20
    assert names["study"].effects == ("cable_spring",)
    assert names["found"].verdict is RecordVerdict.EXPLAINED
    assert names["found"].added == ("cable_spring",)
    true = names["arm"].inertia
    bent, mended = (names[fit].parameters["I"] for fit in ("rigid", "tethered"))
    assert abs(bent.value - true) > 10 * bent.std
    for name, hidden in {**names["hidden"], "I": true}.items():
        found = mended if name == "I" else names["tethered"].parameters[f"cable_spring.{name}"]
        assert abs(found.value - hidden) < 4 * found.std  # six numbers, one in 3000 beyond 4 of any
    assert names["unknown"].verdict is RecordVerdict.UNEXPLAINED
    assert names["unknown"].added == ()
    assert any(f.p_value is not None and f.p_value < 1e-20 for f in names["unknown"].findings)
    assert names["unknown"].unexplained.where.startswith("tau falls near position y")


def contact_force(names: dict[str, Any]) -> None:
    """The rigid tool is off by newtons and sees no push, the tethered one is right; the printed direction is wrong."""
    rigid, found, true = names["rigid"], names["found"], names["true"]
    assert (rigid.systematic_contact_error(true) > 5 * rigid.floor).all()
    assert (found.systematic_contact_error(true) < found.floor / 10 + 2 * found.systematic_contact_error_limit).all()
    assert not rigid.intervals
    assert len(found.intervals) == 4
    assert abs(found.zero_shift[0] - 0.8) < 0.05
    assert abs(names["size"].mean() - 5) < 0.05
    assert abs(names["direction"].mean() - 36.87) < 0.5
    assert abs(names["printed"] - 36.87) > 2


def designed_motion(names: dict[str, Any]) -> None:
    """Each step gains, none beyond the bound; estimates scatter as promised; the designed motion tells drags apart."""
    values = list(names["logdet"].values())
    assert values == sorted(values)
    assert values[1] - values[0] > 4
    assert values[-1] < names["plan"].bound.logdet
    for name, promised in names["promised"].items():
        assert 0.65 < names["scatter"][name] / promised < 1.4  # 40 draws: std of 11 %, one in 1000 beyond
    assert names["before"]["viscous"] - names["before"]["quadratic"] < 21.6
    found = names["after"]["viscous"] - names["after"]["quadratic"]
    assert found > 1000
    expected = names["told"].pairs[0].directions[0].after
    # The plan knows the drag's size from the slow recording, to some 3 %: lambda goes with its square.
    assert abs(found / expected - 1) < 0.3


def the_chapter_checked(names: dict[str, Any]) -> None:
    """Verdicts come of differences: zero where an equation agrees, what is left where an erratum is; the figures."""
    marks = {f"{e.number} {e.states}": e.mark for e in names["equations"]}
    agreeing = {name for name, mark in marks.items() if mark == "agrees"}
    assert agreeing == {
        *("22.2 Ps", "22.2 P", "22.3 G", "22.3 v_G", "22.4 a_G", "22.5 fy - bias", "22.6 theta"),
        *("22.7 Y - V", "22.8 Phi", "22.9 M1 .. M4", "22.10 q1 .. q3"),
    }
    assert {name: mark for name, mark in marks.items() if name not in agreeing} == {
        "22.5 fx - bias": "erratum 1",
        "22.5 tau - bias": "not derivable, erratum 1",
        "22.6 I": "erratum 2",
        "22.13 fc": "open",
        "22.14 fc of R, b": "erratum 7",
        "22.16 tan b": "erratum 3",
        "22.16 R of b": "erratum 3",
    }
    for equation in names["equations"]:
        zero = [all(entry == 0 for entry in difference) for difference in equation.differences]
        assert any(zero) is (equation.mark == "agrees"), equation
    assert [erratum.number for erratum in names["all_errata"]] == list(range(1, 9))
    for erratum in names["all_errata"]:
        assert all(all(entry == 0 for entry in p.difference) is p.equal for p in erratum.proofs), erratum
        assert erratum.number in (5, 6) or any(not p.equal for p in erratum.proofs)
    assert names["in_degrees"].round().tolist() == [42, 44, 35]
    assert (names["in_radians"] > 2000).all()
    decades = [round(value, 1) for value in names["determinant"].values()]
    assert decades[:2] == [25.5, 31.5]
    assert abs(decades[2] - 42) < 0.5
    assert abs(names["returned"] - 2.84) < 5e-3
    for name, figures in {"noise": [0.655, 2.632], "remainder": [0.123, 0.149], "error": [0.005, 0.018]}.items():
        assert names[name].round(3).tolist() == figures
    for name, spread in names["spread"].items():
        assert abs(spread / names["expected"][name] - 1) < 0.15  # 400 draws: 3.5 %, one in 50 000 beyond


def own_effect(names: dict[str, Any]) -> None:
    """Unexplained, and the residual points at the magnet; six lines name it, and the error goes down to the floor."""
    assert names["unknown"].verdict is RecordVerdict.UNEXPLAINED
    assert len(names["text"].strip().splitlines()) == 6
    assert (names["found"].verdict, names["found"].added) == (RecordVerdict.EXPLAINED, ("magnet",))
    for name, true in names["hidden"].items():
        assert abs(names["estimates"][name].value - true) < 4 * names["estimates"][name].std  # four: one in 4000 beyond
    last = names["found"].steps[-1]
    for comparison in (*last.training, *last.validation):
        explainable, floor = comparison.explainable_rms, comparison.noise_floor
        assert all(explainable[c] < 0.3 * floor[c] for c in floor)  # 4 repeats of 150: what noise leaves, and more
    strongest = np.argmax(np.hypot(*names["force"]))
    way, force = np.array([names["x"], names["y"]]) - names["path"][:, strongest], names["force"][:, strongest]
    assert way @ force > 0.95 * np.hypot(*way) * np.hypot(*force)  # the rigid fit has taken in some of the force


def find_it_yourself(names: dict[str, Any]) -> None:
    """By hand and by itself the same is found, and it is what was hidden; the wrong suspicion leaves the error."""
    assert names["suspicion"] == names["secret"]
    assert names["found"].added == (names["secret"],)
    assert names["wrong"].training[0].lack_of_fit < 1e-6
    assert names["right"].training[0].lack_of_fit > 1e-3  # of a true model: one in 1000 below
    assert names["rest"].comparison is names["right"].training[0]


def measured_data(names: dict[str, Any]) -> None:
    """The mass of the poses is that of least squares, the run's is near, no inertia is seen, the touch is found."""
    mass = names["static"]["m"]
    assert abs(mass.value - 0.934) < 0.005
    assert not np.isfinite(names["static"]["Ixx"].std)
    assert not names["touched"].at_rest
    assert names["contact"].intervals
    moving = names["moving"]["m"]
    assert abs(moving.value - mass.value) < 2 * moving.std
    assert moving.std > 5 * mass.std


def no_name_for_it(names: dict[str, Any]) -> None:
    """Nothing of the catalogue explains it; the equation that was hidden is found, and holds on a third motion."""
    assert names["unknown"].verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED)
    (equation,) = names["found"].equations
    assert equation.formula == "F = c v x w at d"
    for name, true in {"c": -0.06, "d": 0.12}.items():
        value, std, _ = equation.parameters[name]
        assert abs(value - true) < 4 * std  # two: one in 8000 beyond
    assert names["after_third"].lack_of_fit > 1e-3  # of a true model: one in 1000 below
    assert not names["nothing"].found


def published_tables(names: dict[str, Any]) -> None:
    """Consistent in 100 %, intervals hold, least squares err as theirs did; contact and Table 22.1 as is said."""
    tools = names["tools"].reset_index()
    theirs, here = (tools[(tools["by"] == names["HERE"]) == ours] for ours in (False, True))
    ways = ("fit", "fit --physical", "fit --inside BOX", "fit --prior BOX", "OLS, accelerations as noisy as theirs")
    plain, physical, inside, prior, noisy = (here[here["way"] == way] for way in ways)
    for better, worse in ((physical, plain), (inside, physical), (prior, inside)):
        assert (better["consistent"] == 100).all()
        assert (better["inertia"].to_numpy() < worse["inertia"].to_numpy()).all()
    assert (prior["inertia"].to_numpy() < theirs.loc[theirs["way"] == "HPS", "inertia"].to_numpy()).all()
    for text in plain["intervals that hold"]:
        held, count = map(int, text.split(" of "))
        assert count == 100
        assert held >= 88  # of 100 intervals of 95 %, as if independent: three times one in 1000
    assert (noisy["consistent"] <= 10).all()
    assert (plain["inertia, median"].to_numpy() < noisy["inertia, median"].to_numpy()).all()
    ratio = noisy["inertia, median"].to_numpy() / theirs.loc[theirs["way"] == "OLS", "inertia, median"].to_numpy()
    assert ((ratio > 0.5) & (ratio < 2)).all()  # other draws of noise: a median of ten
    contact = names["contact"].reset_index()
    ours = contact[contact["way"].str.startswith("ours, with the unit")]
    filtered = contact[contact["by"] != names["HERE"]]
    forces = ["lag, s", "fx, N", "fy, N", "fz, N"]
    assert (ours[forces].to_numpy() <= filtered[forces].to_numpy()).all()
    deviation = names["deviation"]
    assert deviation["rigid tool"].abs().max() > 3
    assert deviation["elastic joints"].abs().max() < 3


CLAIMS = {
    "01_the_chapter": the_chapter_checked,
    "02_first_diagnosis": first_diagnosis,
    "03_find_it_yourself": find_it_yourself,
    "04_your_own_effect": own_effect,
    "05_design_under_limits": designed_motion,
    "06_contact_force": contact_force,
    "07_measured_data": measured_data,
    "08_no_name_for_it": no_name_for_it,
    "09_published": published_tables,
}


def test_every_notebook_has_its_claims() -> None:
    assert {path.stem for path in NOTEBOOKS} == set(CLAIMS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_built_from_its_script(path: Path) -> None:
    """`make notebooks` has been run since the script was edited, and every cell has been executed in order."""
    import jupytext  # slow to import
    import nbformat

    script, notebook = jupytext.read(path), nbformat.read(FOLDER / f"{path.stem}.ipynb", as_version=4)
    assert [(c.cell_type, c.source) for c in notebook.cells] == [(c.cell_type, c.source) for c in script.cells]
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
    assert any("image/png" in o.get("data", {}) for c in notebook.cells for o in c.get("outputs", []))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_imports_truewrench_alone(path: Path) -> None:
    """Beside the standard library, NumPy and what is the subject: equations by SymPy, the tables of a benchmark."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    imported |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    subject = {"01_the_chapter": "sympy", "09_published": "benchmarks"}
    allowed = {"truewrench", "numpy", subject.get(path.stem, "numpy"), *sys.stdlib_module_names}
    assert {name.split(".")[0] for name in imported} <= allowed


def test_notebooks_begin_with_a_question_and_end_with_its_answer() -> None:
    import jupytext  # slow to import

    for path in NOTEBOOKS:
        cells = [cell.source for cell in jupytext.read(path).cells if cell.cell_type == "markdown"]
        assert "**The question: " in cells[0], path
        assert any(cell.startswith("## The answer") for cell in cells[-2:]), path


LONG = {
    "02_first_diagnosis": 31,
    "03_find_it_yourself": 5,
    "04_your_own_effect": 5,
    "05_design_under_limits": 17,
    "07_measured_data": 5,
    "08_no_name_for_it": 20,
    "09_published": 20,
}
"""Processor time, s. What they are made of has tests of its own."""


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=pytest.mark.long(seconds=LONG[p.stem]) if p.stem in LONG else ()) for p in NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, warnings as errors (pytest's setting here as everywhere)."""
    monkeypatch.chdir(tmp_path)
    if path.stem in ("07_measured_data", "09_published"):
        if not AIS2202.is_dir():
            pytest.skip(f"no recordings at {DATA}: set TRUEWRENCH_DATA to the folder that holds `ais2202`")
        monkeypatch.setenv("TRUEWRENCH_DATA", str(DATA))
    CLAIMS[path.stem](runpy.run_path(str(path)))
