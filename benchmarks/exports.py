"""What loads where: tools at the boundary of what a body can be, as `emit` writes them, in MuJoCo and Pinocchio.

    python -m benchmarks.exports

A tool is given as a model file with its exact numbers, or recorded with noise and fitted with `--physical`. A file that
loads must have the mass, the centre of mass and the inertia that were written, to `ROUNDING`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import mujoco
import numpy as np
import pandas as pd
import pinocchio
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import truewrench as tw
from estimation.fit import Fit
from estimation.least_squares.estimates import Estimate
from modeling.chain.model import WrenchModel
from modeling.codegen.code_target import FORMATS
from modeling.codegen.tool_inertia import ToolInertia
from modeling.noise import NoiseSource
from modeling.rig import Convention, SensorDescription
from modeling.space import Space
from truewrench.files.model_file import ModelFile

Array = NDArray[np.float64]

POSE = (0.02, -0.01, 0.045, 0.3, -1.1, 2.0)
"""Of the sensor in the flange, which the same tools are emitted in too: their inertia turns, and is rounded."""
ROUNDING = 1e-9
"""Relative, of the mass and of the largest moment: what files and changes of frame round is 1e-12 at the most."""
NOISE = np.repeat([0.05, 0.0025], 3)
"""N, N m: std of a sample."""
FITTED = ("thin rods", "thin plates", "point masses", "random")
"""Kinds that are recorded and fitted too."""
READERS = ("MuJoCo, MJCF", "MuJoCo, URDF", "Pinocchio, MJCF", "Pinocchio, URDF", "SDF as URDF", "controllers")


def bodies() -> dict[str, list[tuple[Array, Array]]]:
    """Masses (kg) and places (m, sensor frame) by kind of tool."""
    turn = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    line = np.linspace(0.0, 0.2, 5)
    rod = np.column_stack([0 * line, 0 * line, line])
    plate = np.array([(x, y, 0.0) for x in (-0.05, 0.05) for y in (0.0, 0.2)])
    rng = np.random.default_rng(3)
    cloud = rng.uniform(-0.1, 0.1, (9, 3))

    def alike(places: Array, mass: float = 0.1) -> tuple[Array, Array]:
        return np.full(len(places), mass), places

    def thick(half: float) -> Array:
        return np.concatenate([plate + np.array([0, 0, z]) for z in (half, -half)]) @ turn.T

    return {
        "thin rods": [alike(rod), alike(rod @ turn.T), alike(rod @ turn.T + 0.05)],
        "thin plates": [alike(plate), alike(plate @ turn.T), alike(plate @ turn.T + 0.05)],
        "point masses": [alike(np.array([[0.01, 0.02, 0.1]]), 1.0), alike(np.zeros((1, 3)), 1.0)],
        "plates of 20 µm to 0.02 nm": [alike(thick(10.0**-e)) for e in range(5, 12, 2)],
        "1 µg to 1 t": [alike(cloud, 10.0**e) for e in range(-9, 4, 3)],
        "0.1 µm to 10 cm": [alike(cloud * 10.0**e) for e in range(-6, 1, 2)],
        "random": [(rng.uniform(0.02, 0.2, 9), rng.uniform(-0.12, 0.16, (9, 3))) for _ in range(20)],
    }


def model_of(masses: Array, places: Array) -> ModelFile:
    """A model file with the exact numbers of these masses."""
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, places, strict=True))
    values = [*np.zeros(6), masses.sum(), *(masses @ places), *np.asarray(inertia)[np.triu_indices(3)]]
    model = WrenchModel(space=Space.SPACE, convention=Convention.ON_TOOL)
    return ModelFile(
        model=model,
        rig=None,
        parameters={p.name: Estimate(p.name, v, 1e-6, p.unit) for p, v in zip(model.parameters, values, strict=True)},
        covariance=1e-12 * np.eye(16),
        noise_floor=dict.fromkeys(model.channels, 0.05),
        noise_source=NoiseSource.RIG,
        remainder=dict.fromkeys(model.channels, 0.0),
    )


def simulated(mass: float, first_moment: Array, inertia: Array) -> pd.DataFrame:
    """A run of a body that MuJoCo moves, without noise and zero."""
    entries = tuple(float(v) for v in inertia[np.triu_indices(3)])
    rig = replace(
        tw.simulated_rig.SpatialRig(), mass=mass, inertia=entries, bias=(0.0,) * 6, noise=(0.0,) * 6,
        first_moment=(float(first_moment[0]), float(first_moment[1]), float(first_moment[2])),
    )  # fmt: skip
    return tw.simulate(rig, rig.random_motion(seed=1), repeats=2, samples_per_period=200)


@cache
def ball() -> pd.DataFrame:
    """A ball of 1 kg and 1 kg m² that a tool is fixed to, and whose wrench is subtracted: MuJoCo moves no flat body."""
    return simulated(1.0, np.zeros(3), np.eye(3))


def fitted(masses: Array, places: Array, seed: int) -> Fit:
    """`fit --physical` of a simulated run of these masses with noise."""
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, places, strict=True))
    frame = simulated(masses.sum() + 1.0, masses @ places, np.asarray(inertia) + np.eye(3)).copy()
    channels = list(tw.spatial().channels)
    noise = np.random.default_rng(seed).normal(0.0, NOISE, (len(frame), 6))
    frame[channels] += noise - ball()[channels].to_numpy()
    stated = SensorDescription(convention=Convention.ON_TOOL, noise=dict(zip(channels, NOISE.tolist(), strict=True)))
    rig = tw.Rig(sensor=stated)
    return tw.fit(tw.spatial(rig), tw.from_dataframe(frame, rig=rig), constraints=tw.Constraints(physical=True))


Numbers = tuple[float, Array, Array]
"""Mass, centre of mass (3,) and inertia about it (3, 3), as read from a file."""


def read_by_mujoco(text: str) -> Numbers:
    """Of the only body with a mass; a URDF's root link is given a floating joint, else MuJoCo fixes it to the world."""
    if "<robot" in text:
        link = '<mujoco><compiler fusestatic="false"/></mujoco><link name="world"/><link name'
        joint = '<joint name="j" type="floating"><parent link="world"/><child link="tool"/></joint></robot>'
        text = text.replace("<link name", link, 1).replace("</robot>", joint)
    model = mujoco.MjModel.from_xml_string(text)
    turn = Rotation.from_quat(model.body_iquat[-1], scalar_first=True).as_matrix()
    return model.body_mass[-1], model.body_ipos[-1], turn @ np.diag(model.body_inertia[-1]) @ turn.T


def read_by_pinocchio(text: str) -> Numbers:
    """By its reader of URDF or of MJCF; it takes an SDF only where it was built with Gazebo's library."""
    if "<mujoco" in text:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "tool.xml"
            path.write_text(text, encoding="utf-8")
            model = pinocchio.buildModelFromMJCF(str(path))
    else:
        model = pinocchio.buildModelFromXML(text, pinocchio.JointModelFreeFlyer())
    body = model.inertias[-1]
    return body.mass, body.lever, body.inertia


def as_urdf(sdf: str) -> str:
    """A URDF of what an SDF says, element by element."""
    inertial = ElementTree.fromstring(sdf).find("model/link/inertial")
    assert inertial is not None
    pose = (inertial.findtext("pose") or "").split()
    moments = " ".join(f'{e.tag}="{e.text}"' for e in inertial.findall("inertia/*"))
    place = f'<origin xyz="{" ".join(pose[:3])}" rpy="{" ".join(pose[3:])}"/>'
    mass = f'<mass value="{inertial.findtext("mass")}"/>'
    return f'<robot name="r"><link name="l"><inertial>{place}{mass}<inertia {moments}/></inertial></link></robot>'


def read(to: str, text: str) -> Iterator[tuple[str, Numbers | None]]:
    """What each reader of the format finds in a file; None of a controller's, which nothing here loads."""
    if to == "sdf":
        yield "SDF as URDF", read_by_pinocchio(as_urdf(text))
    elif to in ("urdf", "mjcf"):
        yield f"MuJoCo, {to.upper()}", read_by_mujoco(text)
        yield f"Pinocchio, {to.upper()}", read_by_pinocchio(text)
    else:
        yield "controllers", None


def outcome(model: ModelFile | Fit, pose: tuple[float, ...] | None) -> Counter[str]:
    """How many files each reader loaded, and how many were refused by us; AssertionError for other numbers."""
    saved = model if isinstance(model, ModelFile) else ModelFile.of(model)
    tool = ToolInertia.of(saved.model, saved.calibration.theta, saved.covariance)
    tool = tool if pose is None else tool.seen_from(pose)
    count: Counter[str] = Counter()
    for to in FORMATS:
        try:
            text = tw.emit(saved, to, sensor_pose=pose)
        except tw.InputError:
            count["refused by emit"] += 1
            continue
        for reader, numbers in read(to, text):
            count[reader] += 1
            if numbers is not None:
                require_equal(numbers, tool)
    return count


def require_equal(numbers: Numbers, tool: ToolInertia) -> None:
    """AssertionError unless a reader has the numbers of the tool."""
    mass, centre, inertia = numbers
    np.testing.assert_allclose(mass, tool.mass, rtol=ROUNDING)
    np.testing.assert_allclose(centre, tool.centre_of_mass, rtol=0, atol=ROUNDING)
    assert tool.inertia is not None
    np.testing.assert_allclose(inertia, tool.inertia, rtol=0, atol=ROUNDING * np.abs(tool.inertia).max())


def table(*, fits: bool = True) -> pd.DataFrame:
    """A row for each kind of tool, as it stands and fitted: files by reader, and those that emit refuses."""
    rows: dict[str, Counter[str]] = {}
    for kind, members in bodies().items():
        exact, physical = Counter[str](), Counter[str]()
        for number, body in enumerate(members):
            for pose in (None, POSE):
                exact += outcome(model_of(*body), pose)
            if fits and kind in FITTED:
                fit = fitted(*body, seed=number)
                for pose in (None, POSE):
                    physical += outcome(fit, pose)
        rows[f"{kind}, {len(members)}"] = exact
        if physical:
            rows[f"{kind}, {len(members)}, fit --physical"] = physical
    columns = [*READERS, "refused by emit"]
    return pd.DataFrame({name: [row[c] for c in columns] for name, row in rows.items()}, index=columns).T


if __name__ == "__main__":
    print(table().to_string())
