"""Poses at rest: which are missing, judged by the rank at random orientations, by brute force and by fits with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.centre_of_mass import CentreOfMass
from estimation.fit import Fit, fit
from estimation.model_response import predicted_readings
from estimation.pose_advice import CandidatePoses, PoseAdvice, axes_in_words
from estimation.recordings.reading import from_columns, read
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.regressor import regressor
from modeling.compiled.symbolic_vector import numpy_function
from modeling.errors import InputError
from modeling.rig import Convention, Limits, Rig, SensorDescription, Workspace
from modeling.space import Space
from tests.shared.places import AIS2202, needs
from truewrench.simulated_rig import PayloadChange, PlanarRig, SpatialRig, simulate, static_poses

Array = NDArray[np.float64]

ARM, TOOL = PlanarRig(), SpatialRig()
TRUE_PLANE = {"bias_fx": 15.0, "bias_fy": 0.25, "bias_tau": -1.33, "m": 0.9, "mlg": 0.063}
TRUE_SPACE = {"bias_fz": 3.0, "m": 1.2, "mx": 0.01, "my": -0.02, "mz": 0.08}


def rig_of(space: Space, **described: object) -> Rig:
    simulated = ARM if space is Space.PLANE else TOOL
    noise = dict(zip(simulated.channels, simulated.noise, strict=True))
    return Rig(sensor=SensorDescription(noise=noise, convention=Convention.ON_TOOL), **described)  # type: ignore[arg-type]


def model_of(space: Space) -> WrenchModel:
    return planar() if space is Space.PLANE else spatial(rig_of(space))


def posed(space: Space, columns: Mapping[str, Array], rig: Rig | None = None) -> Recording:
    """Poses with the readings that the model predicts for a tool; the std of a linear fit does not depend on them."""
    channels, rig = model_of(space).channels, rig or rig_of(space)
    count = len(next(iter(columns.values())))
    silent = from_columns({**columns, **dict.fromkeys(channels, np.zeros(count))}, rig=rig)
    true = TRUE_PLANE if space is Space.PLANE else TRUE_SPACE
    theta = np.array([true.get(p.name, 0.0) for p in model_of(space).parameters])
    return replace(silent, wrench=predicted_readings(model_of(space), silent, theta))


def general(space: Space, distinct: int, seed: int, rows: int = 6) -> dict[str, Array]:
    """`distinct` random orientations, repeated to fill the rows that a recording needs."""
    rng = np.random.default_rng(seed)
    if space is Space.PLANE:
        return {"phi": np.resize(rng.uniform(-np.pi, np.pi, distinct), rows)}
    quaternions = np.resize(Rotation.random(distinct, rng=rng).as_quat(), (rows, 4))
    return dict(zip(("qx", "qy", "qz", "qw"), quaternions.T, strict=True))


def rank(space: Space, columns: Mapping[str, Array], more: int) -> int:
    """Rank of the regressor at the poses and at `more` random ones, all at rest."""
    model, extra = model_of(space), general(space, max(more, 1), seed=99, rows=more)
    count = len(next(iter(columns.values()))) + more
    symbols = sorted(regressor(model).free_symbols, key=str)
    inputs = {name: np.concatenate([values, extra[name]]) for name, values in columns.items()}
    given = [inputs.get(str(s), np.zeros(count)) for s in symbols]
    phi = regressor(model)
    values = numpy_function(symbols, list(phi))(*given)
    rows = np.stack([np.broadcast_to(v, (count,)) for v in values], axis=1).reshape(-1, phi.cols)
    return int(np.linalg.matrix_rank(rows, tol=1e-8))


def advised(space: Space, columns: Mapping[str, Array], rig: Rig | None = None) -> tuple[Fit, PoseAdvice]:
    fitted = fit(model_of(space), posed(space, columns, rig))
    return fitted, PoseAdvice.of(fitted)


@pytest.mark.parametrize(
    ("space", "distinct", "needed"),
    [(Space.PLANE, 1, 1), (Space.PLANE, 2, 0), (Space.SPACE, 1, 2), (Space.SPACE, 2, 1), (Space.SPACE, 3, 0)],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_as_many_poses_are_missing_as_raise_the_rank(space: Space, distinct: int, needed: int, seed: int) -> None:
    """One pose in the plane leaves two of its five parameters open, a second shows both. In six axes the second adds
    the mass and the first moment across the change of gravity, the third the rest. The rank at random orientations is
    the largest there is, almost surely; that many more are needed, and one fewer is not enough."""
    columns = general(space, distinct, seed)
    _, advice = advised(space, columns)
    full = rank(space, columns, more=8)
    assert full == (5 if space is Space.PLANE else 10)
    least = next(n for n in range(5) if rank(space, columns, more=n) == full)
    assert least == needed
    assert advice.complete == (needed == 0)
    assert len(advice.chosen) == max(needed, 1)


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize("distinct", [1, 2, 4])
def test_with_the_advised_poses_a_fit_has_the_predicted_std(space: Space, distinct: int) -> None:
    columns = general(space, distinct, seed=4)
    fitted, advice = advised(space, columns)
    chosen = {name: values[list(advice.chosen)] for name, values in advice.poses.columns.items()}
    added = {name: np.append(values, chosen[name]) for name, values in columns.items()}
    better = fit(model_of(space), posed(space, added))
    for name, estimate in better.parameters.items():
        # The same rows in another order: rounding times their condition.
        assert advice.after[name] == pytest.approx(estimate.std, rel=1e-7)
        assert advice.before[name] == fitted.parameters[name].std
        assert np.isfinite(estimate.std) == (name not in advice.never)
    assert PoseAdvice.of(better).complete


@pytest.mark.parametrize("space", list(Space))
def test_inertia_takes_motion(space: Space) -> None:
    _, advice = advised(space, general(space, 4, seed=5))
    inertias = tuple(p.name for p in model_of(space).parameters if p.unit == "kg m²")
    assert advice.never == inertias
    assert f"Not identifiable from static poses, only from motion: {', '.join(inertias)}." in str(advice)


@pytest.mark.parametrize("space", list(Space))
def test_no_other_pose_helps_more(space: Space) -> None:
    """By brute force: the determinant of what is seen, over all poses that could have been chosen."""
    columns = general(space, 4, seed=6)
    fitted, advice = advised(space, columns)
    seen = [i for i, p in enumerate(fitted.layout.parameters) if p.name not in advice.never]
    (best,) = advice.chosen

    def volume(i: int) -> float:
        added = {name: np.append(values, advice.poses.columns[name][i]) for name, values in columns.items()}
        return float(np.linalg.slogdet(fit(model_of(space), posed(space, added)).covariance[np.ix_(seen, seen)])[1])

    others = np.random.default_rng(0).choice(len(advice.poses), 10, replace=False)
    assert all(volume(best) <= volume(int(i)) + 1e-9 for i in others)
    assert any(volume(best) < volume(int(i)) - 1e-3 for i in others)


def test_sentences_say_what_to_do() -> None:
    _, advice = advised(Space.PLANE, general(Space.PLANE, 1, seed=7))
    assert advice.missing == ("bias_fx", "bias_fy", "bias_tau", "m", "mlg")
    assert "One more pose is needed for bias_fx, bias_fy, bias_tau, m, mlg, for example:" in str(advice)
    assert "not identifiable" in str(advice)
    assert str(advice.pose_table.rows[0][0]).startswith("phi = ")
    _, advice = advised(Space.SPACE, general(Space.SPACE, 1, seed=7))
    assert "2 more poses are needed" in str(advice)
    assert all(len(str(row[1]).split()) == 4 for row in advice.pose_table.rows)


# ------------------------------------------------------------------------------------------ the poses


def test_orientations_are_what_their_words_say() -> None:
    poses = CandidatePoses.of(posed(Space.SPACE, general(Space.SPACE, 3, seed=8)))
    assert len(poses) == 26
    turns = Rotation.from_quat(np.stack([poses.columns[name] for name in ("qx", "qy", "qz", "qw")], axis=1))
    height = {axis: turns.apply(unit)[:, 2] for axis, unit in zip("xyz", np.eye(3), strict=True)}
    for i, words in enumerate(poses.words):
        for part in words.split(", "):
            *axes, way = part.replace(" and ", " ").split(" ")
            tilt = 90.0 if "°" not in part else float(next(a for a in axes if "°" in a)[:-1])
            expected = {"up": 1.0, "down": -1.0, "level": 0.0}[way] * np.sin(np.deg2rad(tilt))
            for axis in (a for a in axes if a in "xyz"):
                assert height[axis][i] == pytest.approx(expected, abs=0.01)  # degrees are printed whole
    assert axes_in_words(np.array([1.0, -1.0, 0.0])) == "x 45° up, y 45° down, z level"


LENGTHS = (1.0, 0.97, 0.4)
LIMITS = np.array([[-1.0, 0.5], [-0.3, 0.4], [0.1, 1.4]])


def jointed(**described: object) -> Recording:
    limits = Limits(position=LIMITS, velocity=LIMITS, acceleration=LIMITS)
    rig = rig_of(Space.PLANE, link_lengths=LENGTHS, limits=limits, tip_length=0.2, **described)
    return posed(Space.PLANE, {f"q{j + 1}": np.full(3, LIMITS[j].mean()) for j in range(3)}, rig)


def test_postures_keep_the_limits_and_show_all() -> None:
    fitted = fit(planar(), jointed())
    advice = PoseAdvice.of(fitted)
    for j, (low, high) in enumerate(LIMITS):
        angles = advice.poses.columns[f"q{j + 1}"]
        assert low <= angles.min() < low + 0.1
        assert high - 0.1 < angles.max() <= high
        np.testing.assert_allclose(np.rad2deg(angles), np.round(np.rad2deg(angles)), atol=1e-9)
    assert len(advice.chosen) == 1
    assert np.isfinite([advice.after[name] for name in advice.missing]).all()
    phi = sum(advice.poses.columns[f"q{j}"] for j in (1, 2, 3))
    np.testing.assert_allclose(advice.poses.signals["phi"], phi)


def test_the_tip_stays_in_the_workspace() -> None:
    poses = CandidatePoses.of(jointed(workspace=Workspace(x=(-0.5, 1.0), y=(1.9, 3.0))))
    q = np.cumsum([poses.columns[f"q{j}"] for j in (1, 2, 3)], axis=0)
    lengths = np.array([*LENGTHS[:2], LENGTHS[2] + 0.2])[:, None]
    x, y = (lengths * np.sin(q)).sum(axis=0), (lengths * np.cos(q)).sum(axis=0)
    assert 0 < len(poses) < len(CandidatePoses.of(jointed()))
    assert ((x >= -0.5) & (x <= 1.0) & (y >= 1.9)).all()
    with pytest.raises(InputError, match="outside the workspace"):
        CandidatePoses.of(jointed(workspace=Workspace(x=(5.0, 6.0))))


def test_advice_needs_poses() -> None:
    rng = np.random.default_rng(0)
    run = {"time": np.arange(100) / 50, "phi": np.sin(np.arange(100) / 9)}
    run |= {channel: rng.normal(size=100) for channel in ARM.channels}
    with pytest.raises(InputError, match="no recording is of static poses"):
        PoseAdvice.of(fit(planar() + effects.com_offset(), from_columns(run, rig=rig_of(Space.PLANE))))


# ---------------------------------------------------------------------------------- centre of mass


@pytest.mark.parametrize("space", list(Space))
def test_centre_of_mass_of_a_simulated_tool(space: Space) -> None:
    """Within 4.5 std: 1 in 3e4 for the four components of another seed."""
    simulated = ARM if space is Space.PLANE else TOOL
    frame = static_poses(simulated, 24, seed=2).drop(columns="temperature")
    links = {"link_lengths": ARM.link_lengths} if space is Space.PLANE else {}
    found = CentreOfMass.of(fit(model_of(space), from_columns(dict(frame), rig=rig_of(space, **links))))
    true = np.array([ARM.mlg / ARM.mass]) if space is Space.PLANE else np.array(TOOL.first_moment) / TOOL.mass
    assert found.axes == (("tip",) if space is Space.PLANE else ("x", "y", "z"))
    assert np.abs((found.value - true) / found.std).max() < 4.5
    assert found.std.max() < 0.01  # a few mm, and not everything


def test_centre_of_mass_has_the_spread_of_its_quotient() -> None:
    """Drawn from the fit's covariance: 20 000 draws give the std to 0.5 %, 4.5 sigma; the mass is known to 1 %, so
    that the delta method errs by 1e-4."""
    fitted = fit(planar() + effects.com_offset(), posed(Space.PLANE, general(Space.PLANE, 40, seed=9, rows=40)))
    found = CentreOfMass.of(fitted)
    assert found.axes == ("x'", "tip")
    draws = np.random.default_rng(1).multivariate_normal(fitted.theta, fitted.covariance, 20_000, method="eigh")
    names = [p.name for p in fitted.layout.parameters]
    centre = draws[:, [names.index("com_offset.mlx"), names.index("mlg")]] / draws[:, [names.index("m")]]
    np.testing.assert_allclose(found.std, centre.std(axis=0), rtol=4.5 * 0.005)
    together = np.cov(centre.T) / np.outer(found.std, found.std)
    np.testing.assert_allclose(together, found.covariance / np.outer(found.std, found.std), atol=0.05)


@pytest.mark.parametrize("space", list(Space))
def test_a_load_taken_up_is_not_the_tools(space: Space) -> None:
    """Within 4.5 std, of at most three components: 1 in 5e4 of other seeds; the load moves the centre by more."""
    simulated = ARM if space is Space.PLANE else TOOL
    motion = simulated.random_motion(seed=3)
    frame = simulate(simulated, motion, hidden=(PayloadChange(mass=0.3),), repeats=2, samples_per_period=300, seed=3)
    links = {"link_lengths": ARM.link_lengths} if space is Space.PLANE else {}
    recording = from_columns(dict(frame), rig=rig_of(space, **links))
    onset = {"payload_change.time": 0.4 * float(frame["time"].iloc[-1])}
    found = CentreOfMass.of(fit(model_of(space) + "payload_change", recording, start=onset))
    true = np.array([ARM.mlg / ARM.mass]) if space is Space.PLANE else np.array(TOOL.first_moment) / TOOL.mass
    assert np.abs((found.value - true) / found.std).max() < 4.5
    assert found.std.max() < 0.006


def test_centre_of_mass_that_is_not_shown() -> None:
    found = CentreOfMass.of(fit(planar(), posed(Space.PLANE, general(Space.PLANE, 1, seed=3))))
    assert np.isinf(found.std).all()
    assert "not identifiable" in str(found)


@needs(AIS2202)
def test_measured_poses() -> None:
    """A plain look gives 0.934 ± 0.002 kg and (0.3, 0.1, 43.9) mm, to the last digit that is known, twice."""
    rig = Rig.read(AIS2202 / "rig.toml")
    fitted = fit(spatial(rig), read(AIS2202 / "calibration_poses.csv", rig=rig))
    assert fitted.values["m"] == pytest.approx(0.934, abs=0.002)
    np.testing.assert_allclose(CentreOfMass.of(fitted).value, [0.3e-3, 0.1e-3, 43.9e-3], atol=0.2e-3)
    advice = PoseAdvice.of(fitted)
    assert advice.complete
    assert advice.never == ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    assert all(advice.after[n] <= advice.before[n] for n in advice.after if n not in advice.never)
