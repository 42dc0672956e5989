"""A log on disk, read and fitted in chunks, against the same columns in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from estimation.fit import fit
from estimation.stream.chunk import Chunk
from estimation.stream.long_log import read_chunks
from estimation.stream.regressor_map import linear
from modeling.arm import PlanarArm
from modeling.errors import InputError
from modeling.rig import Rig
from modeling.space import Space
from tests.test_chunks import EXACT, noise_model
from tests.test_fit import base

LENGTHS = (1.0, 0.97, 0.4)


def written(folder: Path, suffix: str, space: Space) -> tuple[Path, Chunk]:
    """A log of 1000 rows with its derivatives, and the same as one chunk; joint angles in the plane."""
    rng, n = np.random.default_rng(2), 1000
    tool = base(space)
    if space is Space.PLANE:
        frame = {f"{d}q{j}": rng.standard_normal(n) for d in ("", "d", "dd") for j in (1, 2, 3)}
        series = [np.stack([frame[f"{d}q{j}"] for j in (1, 2, 3)], axis=1) for d in ("", "d", "dd")]
        signals = PlanarArm(LENGTHS).pose(*series)
    else:
        frame = {f"{prefix}{a}": rng.standard_normal(n) for prefix in ("w", "al", "ap") for a in "xyz"}
        frame |= dict(zip(("qx", "qy", "qz", "qw"), Rotation.random(n, rng=rng).as_quat().T, strict=True))
        signals = frame
    emitted = linear(tool)
    assert emitted is not None
    rows = emitted(signals, n)
    truth = 1 + rng.random(len(rows) - 1)
    wrench = (np.tensordot(truth, rows[:-1], 1) + rows[-1]).T + rng.standard_normal((n, len(tool.channels)))
    table = pd.DataFrame({"time": 0.01 * np.arange(n), **frame, **dict(zip(tool.channels, wrench.T, strict=True))})
    path = folder / f"long{suffix}"
    table.to_csv(path, index=False) if suffix == ".csv" else table.to_parquet(path, index=False)
    return path, Chunk(run="long", signals=signals, wrench=wrench)


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_log_is_fitted_from_disk(tmp_path: Path, suffix: str, space: Space) -> None:
    """As many passes as are asked for; text holds every digit of a double."""
    path, whole = written(tmp_path, suffix, space)
    model, rig = noise_model(space, 3), Rig(link_lengths=LENGTHS)
    found = [fit(base(space), read_chunks(path, rig=rig, size=size, overlap=3), noise=model) for size in (64, 1000)]
    expected = fit(base(space), whole, noise=model)
    std = np.sqrt(np.diag(expected.covariance))
    for one in found:
        np.testing.assert_allclose(one.theta / std, expected.theta / std, rtol=0, atol=EXACT)
        assert one.information.rows == expected.information.rows


def test_one_line_for_a_log_that_is_none(tmp_path: Path) -> None:
    path, _ = written(tmp_path, ".csv", Space.PLANE)
    frame, model, rig = pd.read_csv(path), noise_model(Space.PLANE, 0), Rig(link_lengths=LENGTHS)
    cases = [
        (frame.drop(columns="ddq2"), "ddq2 is missing"),
        (frame.drop(columns="time"), "column time is missing"),
        (pd.concat([frame, frame]), "from row 1002 on: time does not increase"),
        (frame.assign(fx=["x"] * len(frame)), "column fx is not numeric"),
        (frame.mask(frame.index.to_series() == 700), "from row 702 on"),
    ]
    for wrong, message in cases:
        wrong.to_csv(path, index=False)
        with pytest.raises(InputError, match=message):
            fit(base(Space.PLANE), read_chunks(path, rig=rig, size=100), noise=model)
    with pytest.raises(InputError, match="cannot be read"):
        fit(base(Space.PLANE), read_chunks(tmp_path / "none.csv"), noise=model)
    with pytest.raises(InputError, match="not below the overlap"):
        read_chunks(path, size=3, overlap=4)
