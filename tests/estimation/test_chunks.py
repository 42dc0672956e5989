"""Recordings and chunks one by one against all at once, in any order and anywhere; noise that is known beforehand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from gc import collect
from multiprocessing import get_context
from weakref import ref

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from estimation.fit import Fit, fit
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from estimation.streaming.chunk import Chunk, chunks
from estimation.streaming.chunk_information import RecordingOrChunk, linear_regressor_map
from estimation.streaming.streamed_fit import MAX_PENDING_PARTS, StreamedFit, estimate_streamed
from modeling import effects
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError
from modeling.noise import NoiseModel, NoiseSource
from modeling.rig import Convention
from modeling.space import Space
from tests.shared.noises import noise_model
from tests.shared.recordings import base, noiseless_columns, recorded
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

EXACT = 1e-10
"""Of a std: what chunks may differ from the whole."""


@cache
def runs(space: Space) -> tuple[Recording, ...]:
    """Three runs of different motions with zeros of their own."""
    zeros = 3.0 * np.random.default_rng(7).standard_normal((3, len(space.channels)))
    return tuple(
        recorded(space, seed=i, repeats=1, motion=5 + i, zero=zero, name=f"run{i}") for i, zero in enumerate(zeros)
    )


def known(model: NoiseModel, several: Sequence[Recording]) -> list[RecordingNoise]:
    """The same noise as a fit of all rows at once takes it, by a whitener of whole records."""
    whiteners = [AutoregressiveWhitener(r.samples, model) for r in several]
    return [RecordingNoise(model.floor, whitener, NoiseSource.RIG, np.zeros(1)) for whitener in whiteners]


@cache
def at_once(space: Space, order: int, block: int = 1) -> Fit:
    """The reference: every row of all runs in one least-squares problem, each run with its own zero."""
    return fit(base(space), runs(space), noise=known(noise_model(space, order, block), runs(space)))


def assert_same(found: StreamedFit, whole: Fit) -> None:
    """In the noise that was given; that of whole runs is told in the colour of their residual."""
    k = len(found.theta)
    covariance = whole.covariance if whole.ordinary is None else whole.ordinary.covariance
    std = np.sqrt(np.diag(covariance)[:k])
    assert found.converged
    np.testing.assert_allclose(found.theta / std, whole.theta[:k] / std, rtol=0, atol=EXACT)
    scale = np.outer(std, std)
    np.testing.assert_allclose(found.covariance / scale, covariance[:k, :k] / scale, atol=EXACT)


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize(("order", "block"), [(0, 1), (3, 1), (2, 5)])
def test_recordings_one_by_one(space: Space, order: int, block: int) -> None:
    """From a sequence, and from an iterator that passes once; the chi-square is that of all rows."""
    model, whole = noise_model(space, order, block), at_once(space, order, block)
    for parts in (runs(space), iter(runs(space))):
        found = fit(base(space), parts, noise=model)
        assert_same(found, whole)
        left = np.concatenate([n.whitener.series(e) for n, e in zip(whole.noise, whole.residuals, strict=True)])
        assert found.misfit == pytest.approx(float(left @ left) / (len(left) - len(whole.theta)), rel=1e-9)
        assert found.identifiable.all()


@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_chunks_in_any_order(data: st.DataObject) -> None:
    """Cut anywhere, mixed anyhow; the run that comes first lends its zero to the result."""
    space, order = data.draw(st.sampled_from([(Space.PLANE, 0), (Space.PLANE, 3), (Space.SPACE, 3)]))
    model = noise_model(space, order)
    cut = [c for r in runs(space) for c in chunks(r, data.draw(st.integers(20, 400)), model.memory)]
    mixed = data.draw(st.permutations(cut))
    home = next(i for i, c in enumerate(mixed) if c.run == "run0")
    assert_same(fit(base(space), [mixed[home], *mixed[:home], *mixed[home + 1 :]], noise=model), at_once(space, order))


def test_recordings_and_chunks_mixed() -> None:
    model, (first, second, third) = noise_model(Space.PLANE, 3), runs(Space.PLANE)
    parts: list[RecordingOrChunk] = [first, *chunks(second, 50, model.memory), third]
    assert_same(fit(base(Space.PLANE), parts, noise=model), at_once(Space.PLANE, 3))


def test_statistics_of_two_machines_add() -> None:
    """Information of the shared parameters from one half and the other: the same as all at once."""
    model, tool = noise_model(Space.PLANE, 0), base(Space.PLANE)
    first, second = fit(tool, runs(Space.PLANE)[:1], noise=model), fit(tool, runs(Space.PLANE)[1:], noise=model)
    zeros = len(tool.biases)
    total = first.information.eliminated(zeros) + second.information.eliminated(zeros)
    whole = at_once(Space.PLANE, 0)
    std = np.sqrt(np.diag(whole.covariance))[zeros : len(first.theta)]
    found = np.linalg.solve(total.root, total.target)
    np.testing.assert_allclose(found / std, whole.theta[zeros : len(first.theta)] / std, rtol=0, atol=EXACT)


def test_std_of_blocks_hold_in_coloured_noise() -> None:
    """AR(0.9) noise has 19 times the power of white noise where a slow motion is; the mean of 150 squares of errors in
    std, some six of them independent in each draw, is 1.05 in theory, and beyond these bounds once in 10^4."""
    rng, samples, draws, tool = np.random.default_rng(11), 6000, 25, base(Space.PLANE)
    time = np.arange(samples)
    signals = {
        name: np.sin(0.013 * (i + 1) * time + i) + np.cos(0.0171 * (i + 2) * time)
        for i, name in enumerate(("phi", "dphi", "ddphi", "ax", "ay"))
    }
    emitted = linear_regressor_map(tool)
    assert emitted is not None
    rows = emitted(signals, samples)
    truth = np.array([1.0, 2.0, 0.3, 1.5, 0.1, 0.02])
    exact = np.tensordot(truth, rows[:-1], 1).T + rows[-1].T
    squares = []
    for _ in range(draws):
        noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal((samples, 3)), axis=0)
        pieces = Chunk(run="run", signals=signals, wrench=exact + noise).pieces(100, overlap=0)
        found = fit(tool, pieces, noise=NoiseModel.white(np.full(3, (1 - 0.9**2) ** -0.5)))
        scattered = found.in_scatter_of_blocks(np.zeros(len(truth)))
        squares.append((found.theta - truth) ** 2 / np.diag(scattered.covariance))
        assert (np.diag(scattered.covariance) >= np.diag(found.covariance)).all()
    assert 0.7 < np.mean(squares) < 1.6
    least = np.full(len(truth), 10.0)
    found = fit(tool, Chunk(run="run", signals=signals, wrench=exact), noise=NoiseModel.white(np.ones(3)))
    np.testing.assert_allclose(np.sqrt(np.diag(found.in_scatter_of_blocks(least).covariance)), least, rtol=1e-12)


def test_recordings_that_passed_are_not_kept() -> None:
    seen: list[ref[Recording]] = []

    def passing() -> Iterator[Recording]:
        for i in range(3):
            collect()
            assert all(one() is None for one in seen[:-1])  # the last one is still in the loop's hands
            recording = recorded(Space.PLANE, seed=i, repeats=1, motion=5, name=f"run{i}")
            seen.append(ref(recording))
            yield recording

    fit(base(Space.PLANE), passing(), noise=noise_model(Space.PLANE, 0))
    assert len(seen) == 3


# ------------------------------------------------------------------------------------------------ executors

POOLS: dict[str, Callable[[], Executor]] = {
    "threads": lambda: ThreadPoolExecutor(2),
    # One, since a new process takes seconds to import; and not forked, of which Python warns when there are threads.
    "processes": lambda: ProcessPoolExecutor(1, mp_context=get_context("spawn")),
}


@pytest.mark.parametrize("pool", POOLS)
def test_parts_elsewhere(pool: str) -> None:
    """The sum is taken in the order of the parts, so that it is the same number to the last bit."""
    space = Space.SPACE
    model = noise_model(space, 3)

    def cut() -> Iterator[Chunk]:
        return (c for r in runs(space) for c in chunks(r, 100, model.memory))

    with POOLS[pool]() as executor:
        found = fit(base(space), cut(), noise=model, executor=executor)
        # An error in a worker comes back as what it is.
        broken = replace(next(cut()), signals={})
        with pytest.raises(InputError, match="the model needs the signal"):
            fit(base(space), [broken], noise=model, executor=executor)
    assert_same(found, at_once(space, 3))
    np.testing.assert_array_equal(found.theta, fit(base(space), cut(), noise=model).theta)


class Lazy(Executor):
    """Works when it is asked for a result, and remembers how many parts it was given at once."""

    def __init__(self) -> None:
        self.waiting = self.most = 0

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
        self.waiting += 1
        self.most = max(self.most, self.waiting)
        lazy = self

        class Asked(Future):  # type: ignore[type-arg]
            def result(self, timeout: float | None = None) -> object:
                lazy.waiting -= 1
                return fn(*args, **kwargs)

        return Asked()


def test_few_parts_are_held_at_once() -> None:
    executor, model = Lazy(), noise_model(Space.PLANE, 0)
    cut = [c for r in runs(Space.PLANE) for c in chunks(r, 10)]
    assert len(cut) > 2 * MAX_PENDING_PARTS
    assert_same(fit(base(Space.PLANE), iter(cut), noise=model, executor=executor), at_once(Space.PLANE, 0))
    assert executor.most == MAX_PENDING_PARTS
    assert executor.waiting == 0


# ------------------------------------------------------------------------- models that are not linear, or remember


def shortened(hidden: Sequence[simulated.HiddenEffect], number: int) -> Recording:
    return recorded(Space.PLANE, *hidden, seed=number, repeats=1, motion=5 + number, name=f"run{number}")


@pytest.mark.parametrize(
    ("effect", "hidden"),
    [
        (effects.viscous_drag(), simulated.ViscousDrag(c=0.5)),
        (effects.sensor_lag(), simulated.SensorLag()),
        (effects.com_offset(), simulated.CentreOfMassOffset()),
    ],
    ids=lambda value: getattr(value, "id", ""),
)
def test_effects_one_by_one(effect: effects.Effect, hidden: simulated.HiddenEffect) -> None:
    """Gauss-Newton in passes ends where it ends in one problem: both within the tolerance of the steps."""
    several = [shortened([hidden], i) for i in range(2)]
    model, tool = noise_model(Space.PLANE, 2), base(Space.PLANE) + effect
    start = {"viscous_drag.c": 0.1} if effect.id == "viscous_drag" else {}
    whole = fit(tool, several, noise=known(model, several), start=start)
    found = fit(tool, several, noise=model, start=start)
    k = len(found.theta)
    std = np.sqrt(np.diag(whole.covariance))[:k]
    np.testing.assert_allclose(found.theta / std, whole.theta[:k] / std, rtol=0, atol=1e-2)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), std, rtol=1e-3)
    assert linear_regressor_map(tool) is None or effect.id == "com_offset"
    if linear_regressor_map(tool) is None:
        with pytest.raises(InputError, match="several passes"):
            fit(tool, iter(several), noise=model, start=start)


def test_an_effect_of_one_run_stays_in_the_first() -> None:
    """A drift belongs to a run: it is fitted to the first, and the others do not have it."""
    several, model, tool = runs(Space.PLANE), noise_model(Space.PLANE, 0), base(Space.PLANE) + effects.bias_drift()
    assert_same(fit(tool, several, noise=model), fit(tool, several, noise=known(model, several)))


@pytest.mark.parametrize("space", list(Space))
def test_regressor_map_is_the_compiled_prediction(space: Space) -> None:
    """Two emissions of one derivation, NumPy and CasADi, at parameters that are not zero."""
    model = base(space) + effects.com_offset() if space is Space.PLANE else base(space)
    emitted, rng = linear_regressor_map(model), np.random.default_rng(3)
    assert emitted is not None
    signals, theta = {n: rng.standard_normal(50) for n in model.inputs}, rng.standard_normal(len(model.parameters))
    rows = emitted(signals, 50)
    prediction = compiled_prediction(model)
    value = prediction.load.value(signals, theta, 50) + prediction.bias.value(signals, theta, 50)
    np.testing.assert_allclose(np.tensordot(theta, rows[:-1], 1) + rows[-1], value.T, atol=1e-12)  # rounding


# ----------------------------------------------------------------------------------------- white noise: sums alone

BILLIONTH = 1e-9
"""Of a std."""


def by_lstsq(model: WrenchModel, chunk: Chunk, noise: NoiseModel) -> tuple[Array, Array]:
    """Parameters and std by `lstsq` of every whitened row, with Phi from CasADi: nothing in common but the physics."""
    prediction, samples = compiled_prediction(model), len(chunk.wrench)
    parts = [
        e.tangent(chunk.signals, np.zeros(len(model.parameters)), samples) for e in (prediction.load, prediction.bias)
    ]
    value, slopes = parts[0][0] + parts[1][0], parts[0][1] + parts[1][1]
    root = np.linalg.inv(np.linalg.cholesky(noise.covariance))
    rows = np.einsum("ce,nek->nck", root, slopes).reshape(-1, slopes.shape[2])
    left = ((chunk.wrench - value) @ root.T).ravel()
    lengths = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.inv(np.linalg.qr(rows / lengths, mode="r"))
    scaled = np.linalg.lstsq(rows / lengths, left, rcond=None)[0]
    return scaled / lengths, np.linalg.norm(inverse, axis=1) / lengths


def moving(space: Space, samples: int, turn: float, model: WrenchModel) -> Chunk:
    """Random motion, angles within `turn` rad of one pose and accelerations as small, and readings of some tool."""
    rng = np.random.default_rng(samples)
    signals = {name: rng.uniform(-1, 1, samples) for name in model.inputs}
    signals |= {name: turn * values for name, values in signals.items() if name in ("ax", "ay", "apx", "apy", "apz")}
    if space is Space.PLANE:
        signals["phi"] = 0.4 + turn * signals["phi"]
    else:
        signals |= {"qx": turn * signals["qx"], "qy": turn * signals["qy"], "qz": turn * signals["qz"]}
        signals["qw"] = np.sqrt(1 - signals["qx"] ** 2 - signals["qy"] ** 2 - signals["qz"] ** 2)
    map_ = linear_regressor_map(model)
    assert map_ is not None
    rows = map_(signals, samples)
    theta = 1 + rng.random(len(rows) - 1)
    wrench = (np.tensordot(theta, rows[:-1], 1) + rows[-1]).T + rng.standard_normal((samples, len(model.channels)))
    return Chunk(run="a", signals=signals, wrench=wrench)


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize("convention", [Convention.ON_TOOL, Convention.ON_SENSOR])
@pytest.mark.parametrize("turn", [0.2, 1e-4])
def test_sums_are_lstsq_of_every_row(space: Space, convention: Convention, turn: float) -> None:
    """Angles of a ten thousandth tell the weight from the zero with a condition kappa of 1e4 and more, which sums of
    products of the rows as they are could not bear. Cut anywhere, it is the same; std to kappa times the rounding."""
    model = replace(base(space), convention=convention)
    noise = noise_model(space, 0)
    chunk = moving(space, 50_000, turn, model)
    theta, std = by_lstsq(model, chunk, noise)
    allowed = BILLIONTH if turn == 0.2 else 1e-6
    for parts in ([chunk], list(chunk.pieces(7_001, 0)), list(chunk.pieces(500, 0))):
        found = fit(model, parts, noise=noise)
        np.testing.assert_allclose(found.theta / std, theta / std, rtol=0, atol=allowed)
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), std, rtol=allowed)
        assert found.information.rows == chunk.wrench.size
        assert (found.condition > 1e3) == (turn < 0.1)


def test_wrench_may_lie_in_memory_as_it_likes() -> None:
    model, noise = base(Space.PLANE), noise_model(Space.PLANE, 0)
    chunk = moving(Space.PLANE, 5_000, 0.2, model)
    columns = replace(chunk, wrench=np.asfortranarray(chunk.wrench))
    whole = {name: np.round(8 * values) for name, values in chunk.signals.items()}
    single = replace(chunk, signals={name: values.astype(np.float32) for name, values in whole.items()})
    pairs = [(columns, chunk), (single, replace(chunk, signals=whole))]
    for one, other in pairs:
        first, second = (estimate_streamed(model, [part], noise).theta for part in (one, other))
        np.testing.assert_array_equal(first, second)


def test_a_chunk_at_rest_tells_what_it_can() -> None:
    """Constant signals leave a rank of one a channel; together with a motion it is as if all had come at once."""
    model, noise = base(Space.PLANE), noise_model(Space.PLANE, 0)
    rest, motion = (moving(Space.PLANE, 4_000, turn, model) for turn in (0.0, 0.3))
    still = {name: np.full(4_000, values[0]) for name, values in rest.signals.items()}
    still |= {"dphi": np.zeros(4_000), "ddphi": np.zeros(4_000)}
    rest = replace(rest, signals=still)
    alone = fit(model, rest, noise=noise)
    assert not alone.identifiable[3:].any()  # weight from zero
    both = Chunk(
        run="a",
        signals={n: np.concatenate([rest.signals[n], motion.signals[n]]) for n in model.inputs},
        wrench=np.concatenate([rest.wrench, motion.wrench]),
    )
    theta, std = by_lstsq(model, both, noise)
    found = fit(model, [rest, motion], noise=noise)
    np.testing.assert_allclose(found.theta / std, theta / std, rtol=0, atol=BILLIONTH)
    assert found.identifiable.all()


def test_readings_without_noise_leave_nothing() -> None:
    """The chi-square of exact readings is rounding, eps² of their own."""
    model = base(Space.SPACE)
    chunk = moving(Space.SPACE, 20_000, 0.3, model)
    map_ = linear_regressor_map(model)
    assert map_ is not None
    exact = np.tensordot(np.arange(1.0, 17), map_(chunk.signals, 20_000)[:-1], 1).T
    found = fit(model, replace(chunk, wrench=exact), noise=NoiseModel.white([1.0] * 6))
    np.testing.assert_allclose(found.theta, np.arange(1.0, 17), rtol=1e-12)
    assert found.misfit < 1e-24 * np.mean(exact**2)


# ------------------------------------------------------------------------------------------------ the noise model


@given(seed=st.integers(0, 2**32 - 1), order=st.integers(0, 4), block=st.integers(1, 4), size=st.integers(8, 90))
@settings(deadline=None)  # a busy machine is no failure
def test_whitening_in_stretches_is_whitening_at_once(seed: int, order: int, block: int, size: int) -> None:
    """Against the whitener of a whole record, which has another filter; stretches overlap by the noise's memory."""
    model = replace(noise_model(Space.PLANE, order), block=block)
    size = max(size, order) * block
    series = np.random.default_rng(seed).standard_normal((347, 3))
    whole = AutoregressiveWhitener(347, model).series(series).reshape(-1, 3)
    parts = []
    for start in range(0, 347, size):
        before = max(start - model.memory, 0)
        parts.append(model.whitened_chunk(series[before : start + size].T, start - before).T)
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-12)


@pytest.mark.parametrize("repeats", [1, 6])
def test_noise_of_a_fit_serves_for_a_stream(repeats: int) -> None:
    """From a residual the autoregression is taken over, without the weights by what a whole run's motion leaves open,
    which no chunk knows: the fit is the same as without them, in that noise. From repeats the spectrum becomes an
    autoregression: the body's std agree within 10 %, what the spectrum's curve (1500 samples in bands) and 30
    coefficients leave. The zeros live on frequency 0, which no line shows: there the curve and the coefficients go on
    each in its own way."""
    recording = recorded(Space.PLANE, seed=3, repeats=repeats, noise="autoregressive")
    whole = fit(base(Space.PLANE), recording)
    model = whole.noise[0].autoregression
    found = fit(base(Space.PLANE), recording, noise=model)
    assert model.source is whole.noise[0].source
    np.testing.assert_array_equal(model.floor, whole.noise[0].floor)
    std, expected = (np.sqrt(np.diag(f.covariance)) for f in (found, whole))
    if repeats == 1:
        weighted = whole.noise[0].whitener
        assert isinstance(weighted, AutoregressiveWhitener)
        unweighted = replace(whole.noise[0], whitener=replace(weighted, weights=None))
        same = fit(base(Space.PLANE), recording, noise=[unweighted])
        np.testing.assert_allclose(found.theta / std, same.theta / std, rtol=0, atol=EXACT)
        whole, expected = same, np.sqrt(np.diag(same.covariance))
    np.testing.assert_allclose(std[3:], expected[3:], rtol=0.1)
    np.testing.assert_allclose(std[:3], expected[:3], rtol=0.4)
    assert np.abs((found.theta - whole.theta) / std).max() < 0.7  # the same data, weighted almost alike


def test_floor_is_the_std_of_a_sample() -> None:
    """Against 1e5 samples of the noise itself: their variance errs by sqrt(2 (1 + a²) / (1 - a²) / 1e5) = 0.6 %."""
    model = noise_model(Space.PLANE, 2)
    rng = np.random.default_rng(5)
    innovations = np.linalg.cholesky(model.covariance) @ rng.standard_normal((3, 100_000))
    drawn = [lfilter([1.0], [1.0, *-a], e) for a, e in zip(model.coefficients.T, innovations, strict=True)]
    np.testing.assert_allclose(model.floor, np.std(drawn, axis=1), rtol=0.02)
    white = model.whitened_chunk(np.array(drawn))
    np.testing.assert_allclose(white @ white.T / white.shape[1], np.eye(3), atol=0.02)  # 4.5 sigma of 0.0045


# --------------------------------------------------------------------------------------------- what cannot be used


def spoiled(chunk: Chunk) -> Chunk:
    return replace(chunk, wrench=np.where(np.arange(len(chunk.wrench))[:, None] == 3, np.nan, chunk.wrench))


def infinite(chunk: Chunk) -> Chunk:
    return replace(chunk, signals={n: np.where(np.arange(len(v)) == 7, np.inf, v) for n, v in chunk.signals.items()})


def test_one_line_for_what_cannot_be_used() -> None:
    model, tool = noise_model(Space.PLANE, 3), base(Space.PLANE)
    recording = runs(Space.PLANE)[0]
    cut = list(chunks(recording, 60, 3))
    cases: list[tuple[WrenchModel, Sequence[RecordingOrChunk], NoiseModel, str]] = [
        (tool, [], model, "no recording was given"),
        (replace(tool, convention=Convention.AUTO), cut, model, "cannot decide the sign"),
        (tool, [spoiled(cut[1])], model, "run0: a signal or a reading is not finite"),
        (tool, [replace(cut[1], history=2)], model, "overlap of 3"),
        (tool, [infinite(cut[1])], noise_model(Space.PLANE, 0), "run0: a signal or a reading is not finite"),
        (tool, [replace(cut[1], signals={})], noise_model(Space.PLANE, 0), "run0: the model needs the signal 'ax'"),
        (tool, cut, noise_model(Space.SPACE, 0), "the noise has 6 channels"),
        (base(Space.SPACE), cut, noise_model(Space.SPACE, 0), "it has 3 channels"),
        (tool + effects.sensor_lag(), cut, model, "the model has dynamics"),
        (replace(tool, convention=Convention.ON_SENSOR), cut, model, "mass comes out as"),
    ]
    for own, parts, noise, message in cases:
        with pytest.raises(InputError, match=message):
            fit(own, parts, noise=noise)
    with pytest.raises(InputError, match="noise cannot be estimated from chunks"):
        fit(tool, iter(cut))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="not below the overlap"):
        next(chunks(recording, 2, 3))
    with pytest.raises(InputError, match="positive definite"):
        NoiseModel.white([1.0, 0.0, 1.0])
    with pytest.raises(InputError, match="signal phi has the shape"):
        Chunk(run="a", signals={"phi": np.zeros(3)}, wrench=np.zeros((4, 3)))


def test_separate_runs_of_one_motion_share_a_zero_but_no_history() -> None:
    """Repeats whose clock starts anew: as many rows less for the noise's memory as there are runs."""
    found = dict(noiseless_columns(Space.PLANE, (), 3, 5))
    del found["temperature"]
    once = len(found["time"]) // 3
    found["time"] = np.tile(found["time"][:once], 3)
    recording = from_columns(found, rig=runs(Space.PLANE)[0].rig)
    assert not recording.continuous
    model = noise_model(Space.PLANE, 3)
    estimated = fit(base(Space.PLANE), recording, noise=model)
    assert estimated.information.rows == 3 * (once - 3) * 3
