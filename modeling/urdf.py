"""URDF: the chain of joints from a robot description's root to one of its frames; or one line that says why not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from modeling.errors import InputError
from modeling.joint import LARGEST, UNMOVED, Four, Joint, JointKind, Placement, Vector
from modeling.spatial_arm import SpatialArm

MOVING = {"revolute": JointKind.REVOLUTE, "continuous": JointKind.REVOLUTE, "prismatic": JointKind.PRISMATIC}
FIXED = "fixed"
NAMED = 12  # frames in an error line: those of a six-axis arm with a flange and a tool, and no more than a line holds


def read_urdf(path: str | Path, sensor_frame: str | None) -> SpatialArm:
    """The arm from the root link, which is the world with z up, to the link `sensor_frame`.

    Joints on the way may be revolute, continuous, prismatic or fixed; whatever else hangs on the robot, meshes and
    inertias included, is not looked at, and nothing beyond this one file is opened. Angles are fixed-axis roll, pitch,
    yaw in rad, lengths m (the URDF specification, http://wiki.ros.org/urdf/XML/joint).
    Raises InputError for what is not a URDF, has no such frame, or moves otherwise.
    """
    description = _Description.of(_robot(Path(path)), str(path))
    chain: list[Joint] = []
    placement = UNMOVED
    for element in description.way_to(description.frame(sensor_frame)):
        read = _JointElement(element, str(path))
        placement = placement.then(read.placement)
        if read.kind is not None:
            chain.append(read.joint(read.kind, placement))
            placement = UNMOVED
    if not chain:
        what, remedy = f"no joint moves between its root and the frame '{sensor_frame}'", "name a frame that moves"
        raise InputError(what=what, where=str(path), remedy=remedy)
    return SpatialArm(tuple(chain), placement)


class _Tree(ElementTree.TreeBuilder):
    """A tree without a document type: nothing else can declare entities, in the file or outside it."""

    def doctype(self, name: str, *_: str | None) -> None:
        raise ValueError(f"it has a document type declaration ({name}), which no URDF needs")


def _robot(path: Path) -> ElementTree.Element:
    remedy = "give a URDF file (expand a xacro file with `xacro` first)"
    try:
        root: ElementTree.Element = ElementTree.fromstring(
            path.read_bytes(), parser=ElementTree.XMLParser(target=_Tree())
        )
    except OSError as error:
        what = error.strerror or "cannot be read"
        raise InputError(what=what, where=str(path), remedy="give the path of a URDF file") from None
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(what=f"not a URDF file: {error}", where=str(path), remedy=remedy) from None
    if root.tag != "robot" or any("xacro" in child.tag for child in root):
        what = "not a URDF file: it still has xacro macros" if root.tag == "robot" else f"not a URDF but <{root.tag}>"
        raise InputError(what=what, where=str(path), remedy=remedy)
    return root


@dataclass(frozen=True)
class _Description:
    """The links by name, and the joint above each that has one."""

    links: tuple[str, ...]
    above: Mapping[str, ElementTree.Element]
    where: str

    @classmethod
    def of(cls, robot: ElementTree.Element, where: str) -> _Description:
        links = tuple(link.get("name", "") for link in robot.findall("link"))
        above: dict[str, ElementTree.Element] = {}
        for joint in robot.findall("joint"):
            child = _link(joint, "child")
            if child in above:
                what = f"link '{child}' hangs on the joints '{above[child].get('name')}' and '{joint.get('name')}'"
                raise InputError(what=what, where=where, remedy="give a URDF in which each link hangs on one joint")
            above[child] = joint
        return cls(links, above, where)

    def frame(self, name: str | None) -> str:
        """The name, if there is such a frame."""
        if name in self.links and name is not None:
            return name
        what = "robot.sensor_frame is missing" if name is None else f"there is no frame '{name}'"
        shown = ", ".join(self.links[-NAMED:])
        there = f"one of its last {NAMED}, {shown}" if len(self.links) > NAMED else f"one of {shown}"
        raise InputError(what=what, where=self.where, remedy=f"name the sensor's frame as robot.sensor_frame: {there}")

    def way_to(self, frame: str) -> list[ElementTree.Element]:
        """The joints from the root to the frame."""
        joints: list[ElementTree.Element] = []
        link, passed = frame, {frame}
        while link in self.above:
            joints.insert(0, self.above[link])
            link = _link(joints[0], "parent")
            if link in passed or link not in self.links:
                trouble = "is its own parent" if link in passed else f"is the parent of '{joints[0].get('name')}' only"
                what = f"link '{link}' {trouble}"
                raise InputError(what=what, where=self.where, remedy="give a URDF whose links form a tree")
            passed.add(link)
        return joints


def _link(joint: ElementTree.Element, role: str) -> str:
    """The link that is the parent or the child of a joint; empty where none is named."""
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


@dataclass(frozen=True)
class _JointElement:
    """One joint of the file."""

    element: ElementTree.Element
    file: str

    @property
    def name(self) -> str:
        return self.element.get("name", "")

    @property
    def kind(self) -> JointKind | None:
        """How it moves; None when it does not."""
        kind = self.element.get("type", "")
        if kind != FIXED and kind not in MOVING:
            raise self.error(f"its type is '{kind}'", "only revolute, continuous, prismatic and fixed ones are read")
        if self.element.find("mimic") is not None:
            raise self.error("it mimics another joint", "give it a coordinate of its own, or fix it")
        return MOVING.get(kind)

    @property
    def placement(self) -> Placement:
        """Of the joint on the link above it."""
        from scipy.spatial.transform import Rotation  # slow to import, and most rigs have no URDF

        x, y, z = self.numbers("origin", "xyz", "0 0 0", 3)
        turn = Rotation.from_euler("xyz", self.numbers("origin", "rpy", "0 0 0", 3))  # lower case: about fixed axes
        i, j, k, w = turn.as_quat().tolist()
        quaternion: Four = (i, j, k, w)
        return Placement(position=(x, y, z), quaternion=quaternion)

    @property
    def axis(self) -> Vector:
        """Its unit axis, x where none is stated."""
        axis = np.array(self.numbers("axis", "xyz", "1 0 0", 3))
        length = float(np.linalg.norm(axis))
        if length < np.finfo(float).tiny:
            raise self.error("its axis has no direction", "correct its <axis>")
        x, y, z = (axis / length).tolist()
        return (x, y, z)

    def joint(self, kind: JointKind, placement: Placement) -> Joint:
        """The joint at this placement on the frame of the moving one before it, with the limits that it states."""
        (low,), (high,) = self.numbers("limit", "lower", "0", 1), self.numbers("limit", "upper", "0", 1)
        (fastest,) = self.numbers("limit", "velocity", "0", 1)
        bounded = self.element.get("type") != "continuous" and low < high
        return Joint(
            name=self.name, kind=kind, placement=placement, axis=self.axis,
            position=(low, high) if bounded else None, velocity=(-fastest, fastest) if fastest > 0 else None,
        )  # fmt: skip

    def numbers(self, tag: str, attribute: str, default: str, count: int) -> list[float]:
        """The numbers in an attribute of a child."""
        child = self.element.find(tag)
        text = default if child is None else child.get(attribute, default)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not all(abs(value) < LARGEST for value in values):
            noun = "a finite number" if count == 1 else f"{count} finite numbers"
            raise self.error(f"{tag} {attribute} is {text[:40]!r} and not {noun}", "correct it")
        return values

    def error(self, what: str, remedy: str) -> InputError:
        """An InputError about this joint."""
        return InputError(what=what, where=f"{self.file}, joint '{self.name}'", remedy=remedy)
