"""A sensor beside its maker's sheet: elements that left it are named, and the maker's own file is corrected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.least_squares.estimates import Estimate
from modeling.chain.model import WrenchModel
from modeling.codegen.sensor_matrix import SensorMatrix
from modeling.errors import InputError
from modeling.noise import NoiseSource
from modeling.rig import Convention, Rig, SensorDescription
from modeling.significance import LEVELS
from modeling.space import Space
from truewrench.command_line import main
from truewrench.emitted import emit, emitted
from truewrench.files.makers_sheet import MakersSheet, SheetComparison
from truewrench.files.model_file import ModelFile

Array = NDArray[np.float64]
Write = Callable[[str], Path]

CHANNELS = Space.SPACE.channels
FULL_SCALE = np.array([130.0, 130.0, 400.0, 10.0, 10.0, 10.0])
SHEET = "channel,full_scale,accuracy\n" + "".join(f"{c},{f:g},1.0\n" for c, f in zip(CHANNELS, FULL_SCALE, strict=True))
LEVER = FULL_SCALE / FULL_SCALE[:, None]
"""Readings at full scale over the full scale of a channel, for each unit of an element."""


def model_file(matrix: Array, std: float = 1e-3, rig: Rig | None = None) -> ModelFile:
    """A fitted sensor of that matrix, all of whose elements have this std, in % of full scale over a hundred."""
    model = WrenchModel(space=Space.SPACE, convention=Convention.ON_TOOL) + "gain" + "sensor_crosstalk"
    gains = np.diag(matrix)
    values = {f"gain.{c}": g for c, g in zip(CHANNELS, gains, strict=True)}
    stds = dict.fromkeys(values, std)
    for i, j in np.argwhere(~np.eye(6, dtype=bool)):
        name = f"sensor_crosstalk.{CHANNELS[i]}_{CHANNELS[j]}"
        values[name], stds[name] = matrix[i, j] / gains[j], std / LEVER[i, j]
    estimates = [
        Estimate(p.name, float(values.get(p.name, 1.0)), stds.get(p.name, 1e-3), p.unit) for p in model.parameters
    ]
    return ModelFile(
        model=model,
        rig=rig,
        parameters={e.name: e for e in estimates},
        covariance=np.diag([e.std**2 for e in estimates]),
        noise_floor=dict.fromkeys(CHANNELS, 0.1),
        noise_source=NoiseSource.RIG,
        remainder=dict.fromkeys(CHANNELS, 0.0),
    )


def sensor(matrix: Array, std: float = 1e-3) -> SensorMatrix:
    saved = model_file(matrix, std)
    return SensorMatrix.of(saved.model, saved.theta, saved.covariance)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(text: str) -> Path:
        (tmp_path / "sheet.txt").write_text(text, encoding="utf-8")
        return tmp_path / "sheet.txt"

    return written


def test_elements_that_left_their_specification_are_named(write: Write) -> None:
    """Planted: 3 % of full scale of ty by fz, and 2 % of the gain of fx; 0.5 % of another is within."""
    truth = np.eye(6)
    truth[4, 2], truth[0, 0], truth[1, 0] = 0.03 / LEVER[4, 2], 1.02, 0.005
    compared = SheetComparison(sensor(truth), MakersSheet.read(write(SHEET), CHANNELS))
    assert compared.outside == ("fx_fx", "ty_fz")
    rows = {row["reading_load"]: row for row in compared.to_frame().reset_index().to_dict("records")}
    assert rows["ty_fz"]["specified"] == "beyond 1 %"
    assert rows["fy_fx"]["specified"] == "within 1 %"
    assert rows["fy_fx"]["p"] < LEVELS.effect  # another than the maker's, and specified all the same
    assert rows["ty_fz"]["% of full scale"] == pytest.approx(3.0)
    assert rows["ty_fz"]["difference"] == pytest.approx(0.03 * 10 / 400)
    assert rows["ty_fz"]["std"] == pytest.approx(1e-3 * 10 / 400, rel=1e-3)
    assert "beyond the sheet's accuracy: fx_fx, ty_fz" in str(compared)
    vague = SheetComparison(sensor(truth, std=0.02), MakersSheet.read(write(SHEET), CHANNELS))
    assert not vague.outside
    assert "not told from 1 %" in str(vague)


def test_what_is_not_estimated_is_no_finding(write: Write) -> None:
    """Crosstalk that the model has not is neither within nor beyond the sheet; beside another matrix it is assumed."""
    model = WrenchModel(space=Space.SPACE, convention=Convention.ON_TOOL) + "gain"
    theta = np.array([p.nominal for p in model.parameters])
    gains = SensorMatrix.of(model, theta, 1e-6 * np.eye(len(theta)))
    compared = SheetComparison(gains, MakersSheet.read(write(SHEET), CHANNELS))
    assert list(compared.to_frame().reset_index()["reading_load"]) == [f"{c}_{c}" for c in CHANNELS]
    assert "taken as stated: 30 elements" in str(compared)
    sheet = replace(compared.sheet, matrix=np.eye(6) + 0.1 * np.eye(6, k=1))
    rows = {
        row["reading_load"]: row for row in SheetComparison(gains, sheet).to_frame().reset_index().to_dict("records")
    }
    assert rows["fx_fy"]["specified"] == ""
    assert "assumed" in str(SheetComparison(gains, sheet))
    assert not SheetComparison(gains, sheet).outside


def test_a_sensor_within_its_sheet_is_rarely_said_to_have_left_it(write: Write) -> None:
    """All elements off by the stated 1 % of full scale, the worst that is specified: at most LEVELS.effect of sets.

    More than 8 of 200 have the probability 1e-3 at that level.
    """
    sheet, rng = MakersSheet.read(write(SHEET), CHANNELS), np.random.default_rng(3)
    nominal, edge, count = sensor(np.eye(6)), np.eye(6) + 0.01 / LEVER, 0
    for _ in range(200):
        drawn = replace(nominal, matrix=edge + 1e-3 / LEVER * rng.normal(size=(6, 6)))
        count += bool(SheetComparison(drawn, sheet).outside)
    assert count <= 8


def test_a_sheet_may_state_its_own_matrix_or_nothing_but_accuracy(write: Write) -> None:
    stated = np.eye(6) + 0.01 * np.arange(36).reshape(6, 6) / 36
    head = ";".join(("channel", *CHANNELS))
    lines = (";".join((c, *map(repr, map(float, row)))) for c, row in zip(CHANNELS, stated, strict=True))
    sheet = MakersSheet.read(write("\n".join((head, *lines))), CHANNELS)
    np.testing.assert_array_equal(sheet.matrix, stated)
    compared = SheetComparison(sensor(stated), sheet)
    np.testing.assert_allclose(compared.difference, 0.0, atol=1e-15)
    assert "nothing is held against it" in str(compared)
    ranges = dict(zip(CHANNELS, FULL_SCALE, strict=True))
    text = "channel,accuracy\n" + "".join(f"{c},1\n" for c in CHANNELS)
    np.testing.assert_array_equal(MakersSheet.read(write(text), CHANNELS, ranges).full_scale, FULL_SCALE)
    rig = Rig(sensor=SensorDescription(range=ranges))
    said = emitted(
        model_file(stated, rig=rig),
        "calibration",
        sheet=write("channel,accuracy\n" + "".join(f"{c},1\n" for c in CHANNELS)),
    )
    assert "within 1 %" in str(said.beside)


# -------------------------------------------------------------------- calibration files in ATI's layout

USER = np.random.default_rng(2).normal(size=(6, 6)) * FULL_SCALE[:, None] / 10
"""N and N m for each volt of six gauges."""


def ati_text(force: str = "N", torque: str = "N-m", *, user: bool = True, factor: Array | None = None) -> str:
    """A file of the layout, with numbers of its own: rows Axis are scaled, and moved by 12 mm along z."""
    rows = USER / (np.ones(6) if factor is None else factor)[:, None]
    to_user = np.diag([0.4, 0.4, 1.3, 0.02, 0.02, 0.02])
    to_user[3, 1], to_user[4, 0] = 0.005, -0.005
    tags = {"Axis": np.linalg.solve(to_user, rows)} | ({"UserAxis": rows} if user else {})
    names = [c.capitalize() for c in CHANNELS]
    lines = [
        f'<{tag} Name="{name}" values="{" ".join(f"{v:.10f}" for v in row)}" max="{size}"/>'
        for tag, matrix in tags.items()
        for name, row, size in zip(names, matrix, FULL_SCALE / (1.0 if factor is None else factor), strict=True)
    ]
    units = f'ForceUnits="{force}" TorqueUnits="{torque}"'
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- of the maker -->
<FTSensor Serial="FT0" NumGages="6"><Calibration {units}>
{chr(10).join(lines)}
<BasicTransform Dx="0" Dy="0" Dz="0.012"/></Calibration></FTSensor>
"""


def rows_of(text: str, tag: str) -> Array:
    lines = ElementTree.fromstring(text).findall(f".//{tag}")
    assert [line.get("Name") for line in lines] == ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]
    return np.array([[float(v) for v in (line.get("values") or "").split()] for line in lines])


POUND = 0.45359237 * 9.80665
UNITS = {
    ("N", "N-m"): (1.0, 1.0),
    ("N", "N-mm"): (1.0, 1e-3),
    ("kN", "kN-m"): (1e3, 1e3),
    ("lb", "in-lb"): (POUND, POUND * 0.0254),
    ("lbf", "lbf-ft"): (POUND, POUND * 12 * 0.0254),
}


@pytest.mark.parametrize("units", UNITS)
def test_the_makers_file_gives_corrected_wrenches(units: tuple[str, str], write: Write) -> None:
    """Of the same volts, in its units; its rows Axis still give its rows UserAxis as they did, and the rest stays."""
    matrix = np.eye(6) + 0.03 * np.random.default_rng(4).normal(size=(6, 6)) / LEVER
    factor = np.repeat(UNITS[units], 3)
    text = ati_text(*units, factor=factor)
    corrected = emit(model_file(matrix), "calibration_ati", sheet=write(text))
    volts = np.random.default_rng(5).normal(size=6)
    np.testing.assert_allclose(matrix @ (factor * (rows_of(corrected, "UserAxis") @ volts)), USER @ volts, rtol=1e-6)
    was, now = ([rows_of(t, tag) for tag in ("Axis", "UserAxis")] for t in (text, corrected))
    np.testing.assert_allclose(now[1], was[1] @ np.linalg.inv(was[0]) @ now[0], rtol=1e-5, atol=1e-6)
    assert corrected.startswith(text[: text.index("<FTSensor")])
    assert "corrected by truewrench" in corrected
    for line in ('max="', '<BasicTransform Dx="0" Dy="0" Dz="0.012"', 'Serial="FT0"'):
        assert corrected.count(line) == text.count(line)
    np.testing.assert_allclose(MakersSheet.read(write(text), CHANNELS).full_scale, FULL_SCALE, rtol=1e-12)


BAD = {
    "no table with a column channel": "fx,fy\n1,2\n",
    "'weight' is not expected": "channel,weight\nfx,2\n",
    "a column is there twice": "channel,accuracy,accuracy\nfx,2,3\n",
    "one row of each channel": "channel,accuracy\nfx,2\n",
    "'1,5' is no number": SHEET.replace("fx,130,1.0", 'fx,130,"1,5"'),
    "'nan' is no number": SHEET.replace("fx,130", "fx,nan"),
    "are above zero": SHEET.replace("fx,130", "fx,-130"),
    "column fy of the matrix is missing": "channel,fx\n" + "".join(f"{c},1\n" for c in CHANNELS),
    "states nothing": "channel,accuracy\n" + "".join(f"{c},\n" for c in CHANNELS),
    "no UserAxis rows": ati_text(user=False),
    "unit of force 'stone'": ati_text("stone"),
    "unit of torque 'N'": ati_text(torque="N"),
    "not an XML file": "<FTSensor",
    "with one Calibration, and it has 0": "<FTSensor/>",
    "document type": '<!DOCTYPE a [<!ENTITY b "c">]><FTSensor>&b;</FTSensor>',
    "one UserAxis of each": ati_text().replace('UserAxis Name="Fx"', 'UserAxis Name="Fy"'),
    "the same six or more numbers": ati_text().replace('UserAxis Name="Fx" values="', 'UserAxis Name="Fx" values="1 '),
    "'x' is no number": ati_text().replace('UserAxis Name="Fx" values="', 'UserAxis Name="Fx" values="x '),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_no_sheet_is_said_in_one_line(what: str, write: Write) -> None:
    with pytest.raises(InputError, match=what) as refused:
        MakersSheet.read(write(BAD[what]), CHANNELS)
    assert "\n" not in str(refused.value)


def test_a_comment_may_have_the_name_of_the_root(write: Write) -> None:
    text = ati_text().replace("<BasicTransform", "<!-- <FTSensor of the maker --><BasicTransform")
    corrected = emit(model_file(np.diag([2.0, 1, 1, 1, 1, 1])), "calibration_ati", sheet=write(text))
    np.testing.assert_allclose(rows_of(corrected, "UserAxis")[0], USER[0] / 2, rtol=1e-6)
    assert corrected.startswith(text[: text.index("<FTSensor")])


def test_a_file_whose_rows_are_dependent_is_not_corrected(write: Write) -> None:
    zeros = " ".join(["0"] * 6)
    text = ati_text()
    for tag in ("Axis", "UserAxis"):
        first = text.partition(f'<{tag} Name="Fx" values="')[2].partition('"')[0]
        with pytest.raises(InputError, match="do not follow"):
            emit(model_file(np.eye(6)), "calibration_ati", sheet=write(text.replace(first, zeros)))


def test_a_file_of_six_axes_is_none_of_a_planar_sensor(write: Write) -> None:
    with pytest.raises(InputError, match="of six axes"):
        MakersSheet.read(write(ati_text()), Space.PLANE.channels)


def test_emit_prints_the_comparison_and_writes_the_file(
    tmp_path: Path, write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    saved, out = tmp_path / "model.json", tmp_path / "sensor.yaml"
    saved.write_text(model_file(np.diag([1.05, 1, 1, 1, 1, 1])).to_text(), encoding="utf-8")
    arguments = ["emit", str(saved), "--to", "calibration", "--sheet", str(write(SHEET)), "--out", str(out)]
    assert main(arguments) == 0
    assert "beyond the sheet's accuracy: fx_fx" in capsys.readouterr().out
    assert "ros__parameters" in out.read_text(encoding="utf-8")
    assert main(arguments[:4]) == 0
    assert "correction" in capsys.readouterr().err  # the text itself is on standard output
    for wrong, reason in (
        (["emit", str(saved), "--to", "calibration_ati"], "none is given"),
        (["emit", str(saved), "--to", "ros2", "--sheet", str(write(SHEET))], "nothing of the sensor's sheet"),
        (["emit", "spatial", "--to", "calibration"], "no values"),
        ([*arguments[:-1], str(write(SHEET))], "would replace"),
    ):
        assert main(wrong) == 2
        assert reason in capsys.readouterr().err
