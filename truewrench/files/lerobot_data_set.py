"""A LeRobot data set with the contact wrench of its episodes as features, in a copy or in its place."""

from __future__ import annotations

import json
import os
import shutil
import stat
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from estimation.contact.contact_wrench import ContactWrench
from estimation.reading.column_map import ColumnMap
from estimation.reading.data_files import CONTACT, CONTACT_STD, PREDICTION, episodes_of
from estimation.reading.log_reader import SourceFile, episode_of, tables_of
from estimation.reading.log_reading import imported
from estimation.recordings.column_table import parquet_file
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.rig import Rig
from truewrench.files.output import require_writable_folder

Array = NDArray[np.float64]

DAMAGED = (ValueError, LookupError, TypeError, AttributeError, pa.ArrowException)
"""What files raise that are not as the format has them."""
ROW = "row of the episode"
"""Signal that tells which row a sample was, whatever the reading left out or put on one clock."""
CHANGING = (
    "data/**/*.parquet", "meta/episodes/**/*.parquet", "meta/episodes_stats.jsonl", "meta/stats.json", "meta/info.json"
)  # fmt: skip
"""The files that change: rows, of which statistics are, and last the description, which names the features."""
QUANTILES = {f"q{percent:02d}": percent / 100 for percent in (1, 10, 50, 90, 99)}
STATISTICS = ("min", "max", "mean", "std", "count", *QUANTILES)
"""What a data set may state of a feature's rows, by its names there."""
USUAL = ("min", "max", "mean", "std", "count")
"""Those that every version states."""


def episodes_asked_for(given: str | Path) -> list[Path]:
    """The episodes of a data set, or the one that is given; InputError for what is neither."""
    place = episode_of(Path(given))
    if place is None:
        remedy = "give DATASET or DATASET/episode_000003, the folder with meta/info.json"
        raise InputError(what="no LeRobot data set", where=str(given), remedy=remedy)
    folder, number = place
    if number is not None:
        return [Path(given)]
    return [folder / f"episode_{episode:06d}" for episode in sorted(episodes_of(folder))]


def read_episode(path: Path, rig: Rig | None) -> Recording:
    """The recording of an episode as one run, with its rows counted in the signal `ROW`."""
    (table,) = tables_of(SourceFile(path))
    counted = replace(table, columns={**table.columns, ROW: np.arange(table.rows, dtype=np.float64)})
    stated = {} if rig is None or rig.columns is None else dict(rig.columns)
    return imported(counted, rig=rig, map=ColumnMap.of({**stated, ROW: ROW}), one_run=True).recording(rig)


def require_place(out: Path, given: str | Path) -> None:
    """InputError unless a copy may be made there, or it is the data set itself."""
    folder, _ = episode_of(Path(given)) or (Path(given), None)
    inside = out.absolute().resolve().is_relative_to(folder.resolve()) and out.resolve() != folder.resolve()
    if inside:
        raise InputError(what="is inside the data set", where=str(out), remedy="give a folder beside it")
    if out.resolve() != folder.resolve() and os.path.lexists(out):
        remedy = "give a new folder, or the data set itself to change it in its place"
        raise InputError(what="is there already", where=str(out), remedy=remedy)
    changing = [path.parent for pattern in CHANGING for path in folder.glob(pattern)]
    for place in dict.fromkeys(changing if out.resolve() == folder.resolve() else [out.absolute().parent]):
        require_writable_folder(place)


def write_features(contacts: Mapping[Path, ContactWrench], out: Path) -> int:
    """Write the contact wrenches of episodes of one data set to `out`; return how many other episodes have none.

    A copy of the whole data set, unless `out` is the data set. Rows without a contact wrench are NaN, and are not in
    the statistics. Raises InputError where a feature of the name is there with another shape.
    """
    places = [episode_of(path) for path in contacts]
    folder = next(place[0] for place in places if place is not None)
    features = {
        place[1]: _values(contact)
        for place, contact in zip(places, contacts.values(), strict=True)
        if place is not None and place[1] is not None
    }
    edits = _Edits(features, next(iter(contacts.values())))
    if out.resolve() == folder.resolve():
        _replace(edits.written(folder, folder))
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        copy = Path(mkdtemp(prefix=f".{out.name}-", dir=out.parent))
        try:
            shutil.copytree(folder, copy, dirs_exist_ok=True)
            _make_writable(copy)
            _replace(edits.written(copy, folder))
            copy.rename(out)
        except BaseException:
            _make_writable(copy)
            shutil.rmtree(copy, ignore_errors=True)
            raise
    return sum(not np.isfinite(values).any() for values in edits.contact.values())


def _make_writable(copy: Path) -> None:
    """Let the owner change the folders of a copy, whose original may be read-only."""
    for place in [copy, *(path for path in copy.rglob("*") if path.is_dir())]:
        place.chmod(place.stat().st_mode | stat.S_IRWXU)


def _replace(changed: Mapping[Path, Path]) -> None:
    """Put new files in the places of old ones; what interrupts it is raised when all are there."""
    waiting = [*changed.items()]
    try:
        while waiting:
            os.replace(*waiting[0])
            del waiting[0]
    except BaseException:
        for new, old in waiting:
            with suppress(OSError):
                os.replace(new, old)
        raise


def _values(contact: ContactWrench) -> dict[str, tuple[Array, NDArray[np.intp]]]:
    """Values (n, p) by feature, with the rows of the episode that they are of."""
    rows = np.rint(contact.recording.signals[ROW]).astype(np.intp)
    series = {CONTACT: contact.wrench, CONTACT_STD: contact.std, PREDICTION: contact.predicted}
    return {name: (values, rows) for name, values in series.items()}


class _Edits:
    """New contents of the files of a data set that change."""

    def __init__(
        self, features: Mapping[int, Mapping[str, tuple[Array, NDArray[np.intp]]]], contact: ContactWrench
    ) -> None:
        self.features = features
        channels = contact.calibration.model.channels
        self.names = {CONTACT: contact.names, CONTACT_STD: contact.names, PREDICTION: channels}
        self.rows: dict[str, dict[int, Array]] = {name: {} for name in self.names}

    @property
    def contact(self) -> Mapping[int, Array]:
        """Contact wrenches by episode, as they are written."""
        return self.rows[CONTACT]

    def written(self, folder: Path, given: Path) -> dict[Path, Path]:
        """Write every file that changes beside the one in `folder` that it is to replace; none if one cannot be.

        `given` is the data set that messages name, of which `folder` may be a copy.
        """
        writers = (
            self._write_rows, self._write_episode_table, self._write_episode_lines, self._write_statistics,
            self._write_description,
        )  # fmt: skip
        files = [
            (w, path) for pattern, w in zip(CHANGING, writers, strict=True) for path in sorted(folder.glob(pattern))
        ]
        changed: dict[Path, Path] = {}
        for write, path in files:
            new = path.with_name(f".{path.name}.new")
            changed[new] = path
            try:
                write(path, new)
            except BaseException as error:
                for begun in changed:
                    begun.unlink(missing_ok=True)
                where = str(given / path.relative_to(folder))
                if isinstance(error, InputError):
                    raise InputError(what=error.what, where=where, remedy=error.remedy) from None
                if isinstance(error, DAMAGED):
                    what = f"is not as a LeRobot data set has it: {type(error).__name__}"
                    raise InputError(what=what, where=where, remedy="give a data set that is whole") from None
                raise
        return changed

    def _write_statistics(self, path: Path, new: Path) -> None:
        """Of all episodes."""
        stats = json.loads(path.read_text(encoding="utf-8"))
        names = _names_of([stats])
        stats |= {f: s for f in self.names if (s := self._statistics(f, names, self.rows[f].values()))}
        new.write_text(json.dumps(stats, indent=4), encoding="utf-8")

    def _write_description(self, path: Path, new: Path) -> None:
        info = json.loads(path.read_text(encoding="utf-8"))
        info["features"] |= self._described(info)
        new.write_text(json.dumps(info, indent=4, ensure_ascii=False), encoding="utf-8")

    def _described(self, info: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """The features in the words of the data set's description."""
        with_rate = any("fps" in feature for feature in info["features"].values())
        rate = {"fps": info["fps"]} if with_rate else {}
        return {
            feature: {"dtype": "float32", "shape": [len(names)], "names": list(names), **rate}
            for feature, names in self.names.items()
        }

    def _write_rows(self, path: Path, new: Path) -> None:
        """A file of rows with the features' columns, those of an earlier call kept where no new values are."""
        with parquet_file(path) as file:
            table = file.read()
        of_row = table.column("episode_index").to_numpy()
        for feature, names in self.names.items():
            values = np.full((len(table), len(names)), np.nan, dtype=np.float32)
            if feature in table.column_names:
                values = _existing(table, feature, len(names), path)
            for episode in np.unique(of_row).tolist():
                rows = np.flatnonzero(of_row == episode)
                if episode in self.features:
                    series, places = self.features[episode][feature]
                    values[rows] = np.nan
                    values[rows[places]] = series
                self.rows[feature][episode] = values[rows].astype(np.float64)
            column = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), len(names))
            table = _with_column(table, feature, column)
        pq.write_table(table, new)

    def _statistics(self, feature: str, names: Sequence[str], series: Iterable[Array]) -> dict[str, list[float]]:
        """Statistics of the finite rows of series (n, k); empty without any."""
        rows = np.concatenate([np.zeros((0, len(self.names[feature]))), *series])
        rows = rows[np.isfinite(rows).all(axis=1)]
        return {name: _statistic(name, rows) for name in names} if len(rows) else {}

    def _write_episode_lines(self, path: Path, new: Path) -> None:
        """Version 2.1: a line an episode."""
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
        names = _names_of([line["stats"] for line in lines])
        for line in lines:
            for feature in self.names:
                rows = self.rows[feature].get(int(line["episode_index"]))
                stats = {} if rows is None else self._statistics(feature, names, [rows])
                line["stats"].pop(feature, None)
                line["stats"] |= {feature: stats} if stats else {}
        new.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")

    def _write_episode_table(self, path: Path, new: Path) -> None:
        """Version 3: a row an episode, a column a statistic; null where an episode has no contact wrench."""
        with parquet_file(path) as file:
            table = file.read()
        stated = {name.rsplit("/", 1)[1] for name in table.column_names if name.startswith("stats/")}
        names = [name for name in STATISTICS if name in stated]
        for feature in self.names:
            rows = [self.rows[feature].get(episode) for episode in table.column("episode_index").to_pylist()]
            stats = [{} if own is None else self._statistics(feature, names, [own]) for own in rows]
            for name in names:
                kind = pa.list_(pa.int64() if name == "count" else pa.float64())
                column = pa.array([own.get(name) for own in stats], kind)
                table = _with_column(table, f"stats/{feature}/{name}", column)
        pq.write_table(table, new)


def _statistic(name: str, rows: Array) -> list[float]:
    """One statistic of rows (n, k), k numbers; the count is one."""
    if name == "count":
        return [len(rows)]
    values = np.quantile(rows, QUANTILES[name], axis=0) if name in QUANTILES else getattr(np, name)(rows, axis=0)
    return [float(value) for value in values]


def _names_of(stats: Sequence[Mapping[str, Mapping[str, Any]]]) -> list[str]:
    """The statistics that a data set states of its features, in our order; the usual ones where it states none."""
    stated = {name for one in stats for feature in one.values() for name in feature}
    return [name for name in STATISTICS if name in (stated or USUAL)]


def _existing(table: pa.Table, feature: str, size: int, path: Path) -> NDArray[np.float32]:
    """The values (n, size) of a feature that a table has; InputError for another shape."""
    lists = table.column(feature).combine_chunks()
    numbers = np.array(lists.flatten().to_numpy(zero_copy_only=False), dtype=np.float32)
    if len(numbers) != size * len(table):
        what = f"the feature {feature} is there with another shape than ({size},)"
        raise InputError(what=what, where=str(path), remedy="remove that feature, or give a data set without it")
    return numbers.reshape(-1, size)


def _with_column(table: pa.Table, name: str, column: Any) -> pa.Table:
    """The table with a column, which replaces one of its name."""
    if name in table.column_names:
        return table.set_column(table.column_names.index(name), name, column)
    return table.append_column(name, column)
