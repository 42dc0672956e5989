"""Calibration file: JSON of a calibration, as `truewrench calibrate --out` writes it and `diagnose` quotes it."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import Field

from diagnosis.calibration import Calibration, EffectPower, Rate
from diagnosis.verdict_rule import RecordVerdict
from modeling.errors import InputError, file_text
from modeling.rig_schema import StrictTable, validated
from truewrench.files.output import atomic_write

REMEDY = "write the file again with `truewrench calibrate --out`"


class _Rate(StrictTable):
    count: int = Field(ge=0)
    total: int = Field(ge=0)
    rate: float
    interval: list[float]

    @property
    def value(self) -> Rate:
        return Rate(min(self.count, self.total), self.total)


class _Power(_Rate):
    parameter: str
    amount: float
    unit: str


class _Calibration(StrictTable):
    recording: str
    sha256: str
    model: list[str]
    verdict: RecordVerdict = Field(strict=False)
    nominal: float
    false_alarms: _Rate
    false_lack_of_fit: _Rate
    refused: int = Field(ge=0)
    named: dict[str, int]
    holds: bool
    power: dict[str, _Power]
    candidates: list[str] | None = None


def write_calibration(calibration: Calibration, path: Path) -> None:
    """Write a calibration as JSON, all of it or nothing."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(calibration.to_data(), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_calibration(path: Path) -> Calibration:
    """The calibration in a JSON file.

    Raises InputError, in one line, for an invalid file.
    """
    where = str(path)
    try:
        data = json.loads(file_text(path, kind="a calibration", syntax="JSON"))
    except (ValueError, RecursionError) as error:
        raise InputError(what=f"not a JSON file: {error}", where=where, remedy=REMEDY) from None
    table = validated(_Calibration, data, where, remedy=REMEDY)
    return Calibration(
        recording=table.recording,
        digest=table.sha256,
        model=tuple(table.model),
        verdict=table.verdict,
        alarms=table.false_alarms.value,
        misfits=table.false_lack_of_fit.value,
        refused=table.refused,
        named=table.named,
        power=tuple(EffectPower(i, p.parameter, p.amount, p.unit, p.value) for i, p in table.power.items()),
        candidates=None if table.candidates is None else tuple(table.candidates),
    )
