"""Surveys: a row for every recording, whatever breaks or dies; what is finished is not done again."""

from __future__ import annotations

import gzip
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from threading import Thread
from time import sleep

import pandas as pd
import psutil
import pytest

import truewrench as tw
from benchmarks.dask_processes import DaskProcesses, dask_processes
from estimation.case import Case
from modeling.errors import InputError
from tests.shared import survey_work as stand_in
from tests.shared.rigs import ARM_TEXT
from truewrench.command_line import main
from truewrench.simulated_rig import PlanarRig, ViscousDrag, simulate, write_recording
from truewrench.surveying import Survey, dask_executor, survey
from truewrench.surveying.dask_executor import local_executor
from truewrench.surveying.survey import OutcomeStore
from truewrench.surveying.survey_task import (
    DiagnosisOutcome,
    SurveyRow,
    SurveyTask,
    diagnosed_outcome,
    failed_outcome,
    fingerprint,
)

NAN = "time,q1,q2,q3,fx,fy,tau\n" + "".join(f"{n / 100},0.1,0.2,{'nan' if n == 7 else 0.3},1,2,3\n" for n in range(50))
MANY = 12


@pytest.fixture
def one() -> Iterator[Executor]:
    """One thread: what the workers are compared with."""
    with ThreadPoolExecutor(1) as executor:
        yield executor


def files(folder: Path, count: int = MANY) -> list[Path]:
    """Files of different contents, for work that reads no recordings."""
    paths = [folder / f"run_{n:02d}.csv" for n in range(count)]
    for number, path in enumerate(paths):
        path.write_text("x" * (number + 1))
    return paths


def runs(path: Path) -> int:
    """How often a stand-in has worked on a file."""
    log = path.with_suffix(".log")
    return len(log.read_text().split()) if log.exists() else 0


def stored(out: Path) -> int:
    return len(list((out / "rows").glob("*.json")))


def lengths(found: Survey) -> list[float | None]:
    """What the stand-ins find: how long each file is."""
    return [row.outcome.sizes[0].value for row in found.rows]


def once_stored(out: Path, count: int, act: Callable[[], None]) -> Thread:
    """A thread that acts when so many outcomes are stored."""

    def watch() -> None:
        while stored(out) < count:
            sleep(0.02)
        act()

    thread = Thread(target=watch, daemon=True)
    thread.start()
    return thread


# ------------------------------------------------------------------------------------------ real diagnoses


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig, two recordings with a drag that grows, one with a NaN, an empty one."""
    folder = tmp_path_factory.mktemp("bench")
    rig = PlanarRig()
    for day in (1, 2):
        motion = rig.random_motion(seed=day, harmonics=3)
        frame = simulate(rig, motion, hidden=[ViscousDrag(c=float(day))], repeats=4, samples_per_period=120, seed=day)
        write_recording(frame, folder / f"run_2026-03-0{day}.csv")
    (folder / "nan.csv").write_text(NAN)
    (folder / "empty.csv").write_text("")
    (folder / "rig.toml").write_text(ARM_TEXT)
    return folder


def without_seconds(row: SurveyRow) -> SurveyRow:
    return replace(row, outcome=replace(row.outcome, seconds=None))


@pytest.mark.long
def test_workers_find_what_one_process_finds(bench: Path, one: Executor, tmp_path: Path) -> None:
    paths = [bench / f for f in ("run_2026-03-02.csv", "nan.csv", "missing.csv", "run_2026-03-01.csv", "empty.csv")]
    options = {"rig": bench / "rig.toml", "only": ["viscous_drag"]}
    alone = tw.survey(paths, **options, executor=one)  # type: ignore[arg-type]
    found = tw.survey(paths, **options, out=tmp_path, workers=2)  # type: ignore[arg-type]
    assert [row.file for row in found.rows] == [str(path) for path in paths]
    assert [without_seconds(row) for row in found.rows] == [without_seconds(row) for row in alone.rows]
    two, nan, missing, first, empty = (row.outcome for row in found.rows)
    for outcome, truth in ((first, 1.0), (two, 2.0)):
        assert (outcome.verdict, outcome.added, outcome.error) == ("explained", ("viscous_drag",), "")
        size = outcome.sizes[0]
        assert size.value is not None
        assert size.std is not None
        assert abs(size.value - truth) < 5 * size.std  # five stds: never by chance
        assert [p.parameter for p in outcome.parameters] == ["m", "mlg", "I"]
        loudest = outcome.loudest
        assert loudest is not None
        assert loudest.systematic_before is not None
        assert loudest.systematic_after is not None
        assert loudest.systematic_after < 0.1 * loudest.systematic_before
    assert nan.error.startswith("column q3 is nan at row 9; ")
    assert missing.error.startswith("cannot be read: No such file or directory; ")
    assert empty.error.startswith("the file is empty; ")
    assert [nan.verdict, missing.verdict, empty.verdict] == [None] * 3
    assert stored(tmp_path) == 4  # all but the missing one, which may appear

    frame = pd.read_parquet(tmp_path / "survey.parquet")
    assert list(frame["file"]) == [str(path) for path in paths]
    assert list(frame["verdict"].fillna("error")) == ["explained", "error", "error", "explained", "error"]
    assert frame["recorded"][3] == pd.Timestamp(2026, 3, 1)
    assert frame["sizes"][0][0]["std"] == two.sizes[0].std
    assert dict(frame["systematic_after"][0]) == {c.channel: c.systematic_after for c in two.channels}


def test_sign_of_the_mass_is_a_row(bench: Path, one: Executor, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(ARM_TEXT + '[sensor]\nconvention = "on_sensor"\n')
    (row,) = survey([bench / "run_2026-03-01.csv"], rig=rig, only=["viscous_drag"], executor=one).rows
    assert row.outcome.verdict is None
    assert "mass" in row.outcome.error


# --------------------------------------------------------------------------------------------- going on


def test_goes_on_where_it_stopped(tmp_path: Path, one: Executor) -> None:
    paths, out = files(tmp_path), tmp_path / "out"
    survey(paths[:5], out=out, executor=one, work=stand_in.quick)
    found = survey(paths, out=out, executor=one, work=stand_in.quick)
    assert found.diagnosed == MANY - 5
    assert [runs(path) for path in paths] == [1] * MANY
    assert lengths(found) == [n + 1 for n in range(MANY)]
    assert len(pd.read_parquet(out / "survey.parquet")) == MANY


def test_changed_recording_is_diagnosed_again(tmp_path: Path, one: Executor) -> None:
    paths, out = files(tmp_path, 3), tmp_path / "out"
    survey(paths, out=out, executor=one, work=stand_in.quick)
    paths[1].write_text("longer by far")
    found = survey(paths, out=out, executor=one, work=stand_in.quick)
    assert [runs(path) for path in paths] == [1, 2, 1]
    assert lengths(found) == [1, 13, 3]


def test_damaged_row_is_diagnosed_again(tmp_path: Path, one: Executor) -> None:
    paths, out = files(tmp_path, 2), tmp_path / "out"
    survey(paths[:1], out=out, executor=one, work=stand_in.quick)
    (damaged,) = (out / "rows").iterdir()
    whole = damaged.read_bytes()
    for times, wrong in enumerate(
        (whole[:40], whole.replace(b"1.0", b"7.0"), whole.replace(b"explained", b"explainef"))
    ):
        assert wrong != whole
        damaged.write_bytes(wrong)
        assert lengths(survey(paths, out=out, executor=one, work=stand_in.quick)) == [1, 2]
        assert [runs(path) for path in paths] == [times + 2, 1]


def test_what_failed_inside_is_a_row_and_tried_again(tmp_path: Path, one: Executor) -> None:
    paths, out = files(tmp_path, 2), tmp_path / "out"
    failed = survey(paths, out=out, executor=one, work=stand_in.failing)
    assert failed.rows[1].outcome.error == "internal error: ZeroDivisionError: in run_01.csv"
    assert stored(out) == 0
    assert lengths(survey(paths, out=out, executor=one, work=stand_in.quick)) == [1, 2]


def test_full_disk_is_an_error(tmp_path: Path, one: Executor, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    paths = files(tmp_path, 3)
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match="No space left on device"):
        survey(paths, out=tmp_path / "out", executor=one, work=stand_in.slow)
    assert list((tmp_path / "out" / "rows").iterdir()) == []


def test_recording_given_twice_is_two_rows_and_one_task(tmp_path: Path, one: Executor) -> None:
    (path,) = files(tmp_path, 1)
    assert lengths(survey([path, path], executor=one, work=stand_in.quick)) == [1, 1]
    assert runs(path) == 1


def test_fingerprint(tmp_path: Path) -> None:
    first, second, table = tmp_path / "a.csv", tmp_path / "b.csv", tmp_path / "a.parquet"
    for path in (first, second, table):
        path.write_bytes(b"same")
    key = fingerprint(first, {"robot": {}}, None)
    assert fingerprint(second, {"robot": {}}, None) == key  # a renamed recording is known
    assert key not in {
        fingerprint(table, {"robot": {}}, None),
        fingerprint(first, {"robot": {"gravity": 9.8}}, None),
        fingerprint(first, {"robot": {}}, ("viscous_drag",)),
        fingerprint(first, {"robot": {}}, None, one_run=True),
    }


def test_fingerprint_of_a_bag_is_that_of_its_files(tmp_path: Path) -> None:
    keys = []
    for name, content in (("one", b"a"), ("copy", b"a"), ("other", b"b")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metadata.yaml").write_bytes(b"version: 5")
        (tmp_path / name / "run.mcap").write_bytes(content)
        keys.append(fingerprint(tmp_path / name, None, None))
    assert keys[0] == keys[1] != keys[2]
    (tmp_path / "copy" / "run.mcap").rename(tmp_path / "copy" / "ran.mcap")
    assert fingerprint(tmp_path / "copy", None, None) != keys[0]
    with pytest.raises(IsADirectoryError):  # a folder of many files, given by mistake
        fingerprint(tmp_path, None, None)


def test_bag_is_not_diagnosed_again(tmp_path: Path, one: Executor) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("version: 5")
    for diagnosed in (1, 0):
        found = survey([tmp_path / "bag"], out=tmp_path / "out", executor=one, work=stand_in.explained)
        assert (found.diagnosed, found.rows[0].outcome.verdict) == (diagnosed, "explained")


def test_error_names_no_path_that_may_change(tmp_path: Path, one: Executor) -> None:
    """The remedy names the file, here one whose name is not UTF-8, as its header is not; the row has the name."""
    content = NAN.replace("tau", "kr\xe4fte").encode("latin-1")
    first, second = (
        Path(os.fsdecode(os.fsencode(tmp_path) + name)) for name in (b"/kr\xe4fte.csv", b"/second  run.csv")
    )
    first.write_bytes(content)
    out = tmp_path / "out"
    found = survey([first], out=out, executor=one)
    says = found.rows[0].outcome.error
    assert says.startswith("not UTF-8 text: ")
    assert says.endswith(
        "; bring the log in first: `truewrench import FILE --out recording.csv`, or `tw.read` with a map"
    )
    assert found.to_frame()["error"][0] == says
    first.rename(second)
    again = survey([second], out=out, executor=one)
    assert (again.diagnosed, again.rows[0].file, again.rows[0].outcome.error) == (0, str(second), says)


@pytest.mark.parametrize("text", ["\udce4 is no text", "\ud800 is none either", "plain"])
def test_internal_error_can_be_stored(text: str) -> None:
    assert failed_outcome(ValueError(text)).error.encode()


@pytest.mark.parametrize("where", ["folder", "file"])
def test_what_the_machine_lacked_is_tried_again(
    where: str, tmp_path: Path, one: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when a folder for temporary files is made, or one of them, while a compressed log is read."""
    path, out, rig = tmp_path / "run.parquet.gz", tmp_path / "out", tw.Rig.from_data({"columns": {"fx": "a"}})
    path.write_bytes(gzip.compress(b"PAR1" + bytes(200)))
    with monkeypatch.context() as patched:
        patched.setattr(tempfile, "TemporaryDirectory", FullDisk if where == "file" else no_room)
        full = survey([path], rig=rig, out=out, executor=one).rows[0].outcome
    assert full.error == (
        "its decompressed copy cannot be written: No space left on device; "
        "free space for temporary files, or set TMPDIR to another folder"
    )
    assert stored(out) == 0
    damaged = survey([path], rig=rig, out=out, executor=one).rows[0].outcome
    assert "Parquet" in damaged.error
    assert stored(out) == 1  # it will be as damaged tomorrow


def no_room(**_: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize(
    "lack", [MemoryError(), ModuleNotFoundError("no such reader"), OSError(5, "Input/output error")]
)
def test_what_was_lacking_is_no_final_outcome(lack: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        try:
            raise lack
        except type(lack):
            raise InputError(what="cannot be read", where="here", remedy="none") from None

    (path,) = files(tmp_path, 1)
    monkeypatch.setattr("truewrench.surveying.survey_task._diagnosis", refused)
    assert not diagnosed_outcome(SurveyTask.of(path, None, None)).final


def test_outcome_of_code_that_was_replaced_is_not_final(
    bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A notebook that is open during an upgrade has loaded other code than that on the disk, which is fingerprinted."""
    task = SurveyTask.of(bench / "nan.csv", None, None)
    assert diagnosed_outcome(task).final
    folder = tmp_path / "diagnosis"
    folder.mkdir()
    (folder / "upgraded.py").write_text("")
    monkeypatch.setattr("truewrench.surveying.survey_task._code_folders", lambda: [folder])
    assert not diagnosed_outcome(task).final


class FullDisk:
    """A temporary folder in which every file is full."""

    def __init__(self, **_: object) -> None:
        self._folder = REAL_FOLDER()

    def __enter__(self) -> str:
        folder = self._folder.__enter__()
        Path(folder, "log.parquet").symlink_to("/dev/full")
        return folder

    def __exit__(self, *error: object) -> None:
        self._folder.cleanup()


REAL_FOLDER = tempfile.TemporaryDirectory


def test_no_period_reaches_the_diagnosis(bench: Path, one: Executor, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the diagnosis says how many repeats it was given."""

    def counted(case: Case, **_: object) -> None:
        raise InputError(what=f"{case.recordings[0].repeats} repeats", where="here", remedy="none")

    monkeypatch.setattr("truewrench.surveying.survey_task.diagnose_case", counted)
    for one_run, says in ((False, "4 repeats"), (True, "1 repeats")):
        (row,) = survey([bench / "run_2026-03-01.csv"], rig=bench / "rig.toml", executor=one, one_run=one_run).rows
        assert says in (row.outcome.error or "")


def test_store_keeps_every_field(tmp_path: Path, bench: Path, one: Executor) -> None:
    (row,) = survey([bench / "nan.csv"], rig=bench / "rig.toml", executor=one).rows
    store = OutcomeStore(tmp_path)
    for key, outcome in (
        ("a", row.outcome),
        ("b", DiagnosisOutcome(verdict="explained", misfit=0.1 + 0.2, added=("x", "y"))),
    ):
        store.put(key, outcome)
        assert store.get(key) == outcome
    assert store.get("c") is None


# ------------------------------------------------------------------------------------- whoever dies


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskProcesses]:
    with dask_processes(tmp_path_factory.mktemp("dask"), workers=2, processes=1) as started:
        yield started


@pytest.mark.long
def test_killed_worker_costs_no_row(tmp_path: Path, cluster: DaskProcesses) -> None:
    paths, out = files(tmp_path), tmp_path / "out"
    killer = once_stored(out, 3, lambda: cluster.kill_worker(0))
    found = survey(paths, out=out, scheduler=cluster.address, work=stand_in.slow)
    killer.join(timeout=10)
    assert cluster.workers[0].wait(timeout=10) == -signal.SIGKILL
    assert lengths(found) == [n + 1 for n in range(MANY)]
    workers = {pid for path in paths for pid in path.with_suffix(".log").read_text().split()}
    assert len(workers) == 2  # both had begun


@pytest.mark.long
def test_dask_client_is_an_executor(tmp_path: Path, cluster: DaskProcesses) -> None:
    paths = files(tmp_path, 3)
    from distributed import Client  # slow to import

    with Client(cluster.address, set_as_default=False) as client:
        assert lengths(survey(paths, executor=client, work=stand_in.quick)) == [1, 2, 3]
        assert lengths(survey(paths, executor=client, work=stand_in.quick)) == [1, 2, 3]  # it is still the caller's


def test_recording_that_differs_where_it_is_diagnosed(tmp_path: Path, one: Executor) -> None:
    (path,) = files(tmp_path, 1)

    def rewritten(task: SurveyTask) -> DiagnosisOutcome:
        path.write_text("something else")
        return diagnosed_outcome(task)

    (row,) = survey([path], out=tmp_path / "out", executor=one, work=rewritten).rows
    assert row.outcome.error.startswith("is another file")
    assert not (tmp_path / "out" / "rows").exists()


@pytest.mark.long
def test_recording_that_kills_its_workers_is_one_row(tmp_path: Path) -> None:
    paths = files(tmp_path, 6)
    paths[2].write_text("poison")
    import dask  # slow to import

    with dask.config.set({"distributed.scheduler.allowed-failures": 1}):  # 3 by default: each death costs a new process
        found = survey(paths, out=tmp_path / "out", workers=2, work=stand_in.deadly)
    errors = [row.outcome.error for row in found.rows]
    assert errors[2].startswith("internal error: KilledWorker")
    assert [e for e in errors if e] == [errors[2]]
    assert stored(tmp_path / "out") == 5


def test_executor_that_ends_with_a_worker_keeps_what_is_done(tmp_path: Path, one: Executor) -> None:
    """The pool of `concurrent.futures` does nothing any more once a worker has died: no recording is at fault."""
    paths, out = files(tmp_path, 4), tmp_path / "out"
    survey(paths[:2], out=out, executor=one, work=stand_in.quick)
    paths[2].write_text("poison")
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(
            InputError, match=r"a worker of the executor died.*: on Dask a recording that ends its worker is a row"
        ),
    ):
        survey(paths, out=out, executor=pool, work=stand_in.deadly)
    assert stored(out) == 2
    with pytest.raises(InputError, match="a worker of the executor died"):
        survey(paths, out=out, executor=pool_that_broke(), work=stand_in.deadly)


def pool_that_broke() -> Executor:
    """A pool whose worker has died already."""
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    with pytest.raises(BrokenExecutor):
        pool.submit(os.abort).result()
    return pool


@pytest.mark.long
def test_killed_client_goes_on(tmp_path: Path, one: Executor) -> None:
    paths, out = files(tmp_path), tmp_path / "out"
    client = subprocess.Popen(
        [sys.executable, "-m", "tests.shared.survey_work", str(tmp_path)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    once_stored(out, 4, lambda: os.kill(client.pid, signal.SIGKILL)).join(timeout=60)
    assert client.wait(timeout=10) == -signal.SIGKILL
    assert not (out / "survey.parquet").exists()
    kept = stored(out)
    assert 4 <= kept < MANY
    found = survey(paths, out=out, executor=one, work=stand_in.quick)
    assert found.diagnosed == MANY - kept
    assert lengths(found) == [n + 1 for n in range(MANY)]


@pytest.mark.long
def test_lost_scheduler_is_an_error_and_keeps_what_is_done(tmp_path: Path) -> None:
    paths, out = files(tmp_path), tmp_path / "out"
    with dask_processes(tmp_path, workers=1, processes=1) as started:
        once_stored(out, 3, started.scheduler.kill)
        with pytest.raises(InputError, match="the scheduler does not answer any more"):
            survey(paths, out=out, scheduler=started.address, work=stand_in.slow)
    assert 3 <= stored(out) < MANY


@pytest.mark.long
@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be held here")
@pytest.mark.parametrize("delay", [0.0, 0.04, 0.1, 0.3])
def test_an_interrupt_while_workers_start_is_quiet(delay: float, bench: Path, tmp_path: Path) -> None:
    """As of a terminal, for every process of the group, so many seconds after the first worker's was begun."""
    argv = ["survey", str(bench / "nan.csv"), str(bench / "empty.csv"), "--out", str(tmp_path / "out")]
    client = subprocess.Popen(
        [sys.executable, "-m", "truewrench", *argv], stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # which a shell's background has ignored
    )  # fmt: skip
    while client.poll() is None and not any("spawn_main" in name for name in _commands_below(client.pid)):
        sleep(0.002)
    sleep(delay)
    os.killpg(client.pid, signal.SIGINT)
    assert (client.communicate(timeout=60)[1], client.returncode) == ("", 130)


def _commands_below(pid: int) -> list[str]:
    commands = []
    for process in psutil.Process(pid).children(recursive=True):
        with suppress(psutil.Error):
            commands.append(" ".join(process.cmdline()))
    return commands


def test_nothing_listens_beyond_the_loopback(cluster: DaskProcesses) -> None:
    assert all(worker.pid for worker in cluster.workers)
    with local_executor(2) as executor, local_executor(1):  # and two do not want one port
        assert executor.submit(abs, -1).result() == 1
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        listening = [c for p in processes for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
    assert len(listening) >= 3
    assert {c.laddr.ip for c in listening} == {"127.0.0.1"}


# -------------------------------------------------------------------------------------- the command


@pytest.mark.long
def test_command(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recordings = [str(bench / name) for name in ("nan.csv", "missing.csv")]
    options = ["--rig", str(bench / "rig.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert main(["survey", *recordings, *options]) == 0
    printed = capsys.readouterr()
    assert "2 recordings" in printed.out
    assert f"{recordings[0]}: column q3 is nan at row 9" in printed.out
    assert printed.err == ""
    assert main(["survey", recordings[0], *options, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["verdicts"] == {"error": 1}
    assert data["diagnosed"] == 0  # its row was stored
    assert [row["file"] for row in data["rows"]] == recordings[:1]
    assert main(["survey", recordings[0], *options, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main(["survey", recordings[0], *options, "--json", "--no-period"]) == 0
    assert json.loads(capsys.readouterr().out)["diagnosed"] == 1  # what was stored counted repeats


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--scheduler", "tcp://127.0.0.1:9"], "no scheduler answers"),
        (["--scheduler", "nowhere"], "no scheduler answers: missing port"),
        (["--rig", "missing.toml"], "give the path of a rig file"),
        (["--out", __file__], "is not a folder"),
        (["--workers", "0"], "at least one"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:9"], "not allowed with"),
    ],
)
def test_bad_usage_is_one_line(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(dask_executor, "CONNECT_TIMEOUT", 0.5)
    (path,) = files(tmp_path, 1)
    assert main(["survey", str(path), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert says in printed.err
    assert sorted(p.name for p in tmp_path.iterdir()) == [path.name]


def test_unknown_effect_and_two_places(tmp_path: Path, one: Executor) -> None:
    (path,) = files(tmp_path, 1)
    with pytest.raises(InputError, match="phlogiston"):
        survey([path], only=["phlogiston"], executor=one)
    with pytest.raises(InputError, match="exclude one another"):
        survey([path], executor=one, workers=2)
    with pytest.raises(InputError, match="one worker or more"):
        survey([path], workers=0)


def test_dask_is_imported_only_for_a_survey() -> None:
    program = (
        "import sys, truewrench; from truewrench.command_line import parser; parser(); truewrench.survey; "
        "sys.exit(any(m.split('.')[0] in ('dask', 'distributed', 'tornado') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
