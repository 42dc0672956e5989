"""URDF reader: the chain of joints from the root link to a given frame."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from modeling.errors import InputError
from modeling.kinematics.arm import SpatialArm
from modeling.kinematics.placement import (
    IDENTITY_PLACEMENT,
    LARGEST_NUMBER,
    Body,
    Joint,
    JointKind,
    Placement,
    Quaternion,
    Vector3,
    is_possible,
    rotated_vector,
    translated,
)

MOVABLE_JOINTS = {"revolute": JointKind.REVOLUTE, "continuous": JointKind.REVOLUTE, "prismatic": JointKind.PRISMATIC}
FIXED = "fixed"
FRAMES_LISTED = 12
"""Frames listed in a message: enough for a six-axis arm with flange and tool, on one line."""


def read_urdf(path: str | Path, sensor_frame: str | None) -> SpatialArm:
    """The arm from the root link, which is the world with z up, to the link `sensor_frame`.

    Joints of the chain may be revolute, continuous, prismatic or fixed. Other branches, meshes and inertias are
    ignored, and no other file is opened. Angles are fixed-axis roll, pitch, yaw in rad, lengths m
    (URDF specification, http://wiki.ros.org/urdf/XML/joint).
    Raises InputError for a file that is no URDF, a missing frame, or another type of joint.
    """
    description = _Description.of(_robot(Path(path)), str(path))
    chain: list[Joint] = []
    placement = IDENTITY_PLACEMENT
    for element in description.joints_to(description.frame(sensor_frame)):
        read = _JointElement(element, str(path))
        placement = placement.then(read.placement)
        if read.kind is not None:
            chain.append(read.joint(read.kind, placement))
            placement = IDENTITY_PLACEMENT
    if not chain:
        what, remedy = f"no movable joint between its root and the frame '{sensor_frame}'", "name a frame that moves"
        raise InputError(what=what, where=str(path), remedy=remedy)
    return SpatialArm(tuple(chain), placement)


def link_frames(path: str | Path, sensor_frame: str | None) -> dict[str, tuple[int, Placement]]:
    """Of each link: the joints up to the sensor's frame that move it, and its place in the last one's frame.

    Joints of other branches, such as a gripper's, are taken at coordinate zero.
    """
    links = _MovedLinks.of(path, sensor_frame).links()
    return {link.get("name", ""): (joints, placement) for link, joints, placement in links}


@dataclass(frozen=True)
class DriveData:
    """What a URDF says of an arm's joints as drives.

    bodies    of all links that the joints move, each with its mass
    effort    of each joint the largest torque, N m (force, N, of a prismatic one); 0 where it states none
    damping   of each joint, N m s/rad (N s/m)
    friction  of each joint, N m (N)
    """

    bodies: tuple[Body, ...]
    effort: tuple[float, ...]
    damping: tuple[float, ...]
    friction: tuple[float, ...]


def drive_data(path: str | Path, sensor_frame: str | None) -> DriveData:
    """The bodies that the joints up to the sensor's frame move, and what these joints state.

    Links of other branches move with the link that they branch from, those of a gripper too: their joints are taken at
    coordinate zero. Raises InputError as `read_urdf` does, and for a negative mass or an impossible inertia.
    """
    moved = _MovedLinks.of(path, sensor_frame)
    read = [_body(link, str(path), placement, joint) for link, joint, placement in moved.links() if joint]
    bodies = tuple(body for body in read if body is not None)
    stated = [
        tuple(joint.numbers(tag, attribute, "0", 1)[0] for joint in moved.chain if joint.kind is not None)
        for tag, attribute in (("limit", "effort"), ("dynamics", "damping"), ("dynamics", "friction"))
    ]
    return DriveData(bodies, *stated)


def collision_capsules(
    path: str | Path, sensor_frame: str | None, besides: Collection[str]
) -> list[tuple[str, int, Vector3, Vector3, float]]:
    """Capsules around the collision geometry of all links, but those named `besides`.

    Of each its link, the joints that move it, its ends in the frame that the last of them moves, and its radius, m. A
    cylinder's has its axis and radius; a box's the longest axis of the box, and its ends' half diagonal as radius.
    Raises InputError as `read_urdf` does, and for a mesh, which is in another file.
    """
    capsules = list[tuple[str, int, Vector3, Vector3, float]]()
    for link, joints, placement in _MovedLinks.of(path, sensor_frame).links():
        name = link.get("name", "")
        for element in link.findall("collision") if name not in besides else ():
            shape = _Element(element, str(path), f"link '{name}'")
            half, radius = _half_axis(shape)
            at = placement.then(shape.placement)
            start, end = (translated(at.position, rotated_vector(at.quaternion, p)) for p in ([-x for x in half], half))
            capsules.append((name, joints, _vector(start), _vector(end), radius))
    return capsules


def _half_axis(shape: _Element) -> tuple[list[float], float]:
    """Half the axis of the capsule around a collision geometry, in its own frame, and its radius; m."""
    geometry = shape.element.find("geometry")
    solid = next(iter(geometry), None) if geometry is not None else None
    kind = "of no kind" if solid is None else f"a {solid.tag}"
    read = shape if geometry is None else _Element(geometry, shape.file, shape.called)
    half, sizes = [0.0, 0.0, 0.0], list[float]()
    if kind == "a sphere":
        sizes = read.numbers("sphere", "radius", "0", 1)
        radius = sizes[0]
    elif kind == "a cylinder":
        sizes = [*read.numbers("cylinder", "radius", "0", 1), *read.numbers("cylinder", "length", "0", 1)]
        radius, half[2] = sizes[0], sizes[1] / 2
    elif kind == "a box":
        sizes = read.numbers("box", "size", "0 0 0", 3)
        longest = int(np.argmax(sizes))
        half[longest] = sizes[longest] / 2
        radius = float(np.linalg.norm(np.delete(sizes, longest))) / 2
    else:
        remedy = "state a [[capsule]] with this link, which takes its place"
        raise shape.error(f"its collision geometry is {kind}, and no capsule is fitted to that", remedy)
    if min(sizes) <= 0:
        raise shape.error(f"its collision geometry, {kind}, has no size", "correct it")
    return half, radius


def _vector(components: Sequence[float]) -> Vector3:
    x, y, z = components
    return (x, y, z)


@dataclass(frozen=True)
class _MovedLinks:
    """All links of a file, with what of them the joints up to the sensor's frame move."""

    robot: ElementTree.Element
    description: _Description
    chain: tuple[_JointElement, ...]

    @classmethod
    def of(cls, path: str | Path, sensor_frame: str | None) -> _MovedLinks:
        robot = _robot(Path(path))
        description = _Description.of(robot, str(path))
        joints = description.joints_to(description.frame(sensor_frame))
        return cls(robot, description, tuple(_JointElement(joint, str(path)) for joint in joints))

    def links(self) -> Iterator[tuple[ElementTree.Element, int, Placement]]:
        """Each link, the joints of the chain that move it, and its place in the frame that the last of them moves.

        Joints of other branches are taken at coordinate zero.
        """
        moving = {id(joint.element) for joint in self.chain if joint.kind is not None}
        for link in self.robot.findall("link"):
            joints, placement = 0, IDENTITY_PLACEMENT
            for element in self.description.joints_to(link.get("name", "")):
                moves = id(element) in moving
                on_parent = _JointElement(element, self.description.where).placement
                joints, placement = joints + moves, IDENTITY_PLACEMENT if moves else placement.then(on_parent)
            yield link, joints, placement


def _body(link: ElementTree.Element, file: str, placement: Placement, joint: int) -> Body | None:
    """The body of a link with this place in the frame that so many joints move; None without mass."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    read = _Element(inertial, file, f"link '{link.get('name', '')}'")
    (mass,) = read.numbers("mass", "value", "0", 1)
    if mass < 0:
        raise read.error(f"its mass is {mass:g} kg", "correct it")
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (read.numbers("inertia", name, "0", 1)[0] for name in names)
    inertia = (xx, xy, xz, yy, yz, zz)
    if not is_possible(inertia):
        stated = ", ".join(f"{name} {moment:g}" for name, moment in zip(names, inertia, strict=True))
        raise read.error(f"no body has its moments of inertia, {stated} kg m²", "correct them")
    own = Body(joint=0, mass=mass, centre=(0.0, 0.0, 0.0), inertia=inertia)
    return own.moved(placement.then(read.placement), joint) if mass else None


class RestrictedTreeBuilder(ElementTree.TreeBuilder):
    """XML tree builder that refuses a document type, so that no entities can be declared."""

    def doctype(self, name: str, *_: str | None) -> None:
        raise ValueError(f"it has a document type declaration ({name}), which is not read")


def _robot(path: Path) -> ElementTree.Element:
    remedy = "give a URDF file (expand a xacro file with `xacro` first)"
    try:
        root: ElementTree.Element = ElementTree.fromstring(
            path.read_bytes(), parser=ElementTree.XMLParser(target=RestrictedTreeBuilder())
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
    """The links by name, and the parent joint of each link that has one."""

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
                what = f"link '{child}' has the parent joints '{above[child].get('name')}' and '{joint.get('name')}'"
                raise InputError(what=what, where=where, remedy="give a URDF in which each link has one parent joint")
            above[child] = joint
        return cls(links, above, where)

    def frame(self, name: str | None) -> str:
        """The name of an existing frame; InputError otherwise."""
        if name in self.links and name is not None:
            return name
        what = "robot.sensor_frame is missing" if name is None else f"there is no frame '{name}'"
        listed = ", ".join(self.links[-FRAMES_LISTED:])
        choice = f"one of its last {FRAMES_LISTED}, {listed}" if len(self.links) > FRAMES_LISTED else f"one of {listed}"
        raise InputError(what=what, where=self.where, remedy=f"name the sensor's frame as robot.sensor_frame: {choice}")

    def joints_to(self, frame: str) -> list[ElementTree.Element]:
        """The joints from the root to the frame."""
        joints: list[ElementTree.Element] = []
        link, visited = frame, {frame}
        while link in self.above:
            joints.insert(0, self.above[link])
            link = _link(joints[0], "parent")
            if link in visited or link not in self.links:
                fault = (
                    "is its own parent"
                    if link in visited
                    else f"is the parent of '{joints[0].get('name')}' but not defined"
                )
                what = f"link '{link}' {fault}"
                raise InputError(what=what, where=self.where, remedy="give a URDF whose links form a tree")
            visited.add(link)
        return joints


def _link(joint: ElementTree.Element, role: str) -> str:
    """Name of the parent or child link of a joint; empty if none is given."""
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


@dataclass(frozen=True)
class _Element:
    """An element of the file with an origin, and how a message calls it."""

    element: ElementTree.Element
    file: str
    called: str

    @property
    def placement(self) -> Placement:
        """Placement of its origin on its parent."""
        from scipy.spatial.transform import Rotation  # slow to import, and most rigs have no URDF

        x, y, z = self.numbers("origin", "xyz", "0 0 0", 3)
        rotation = Rotation.from_euler("xyz", self.numbers("origin", "rpy", "0 0 0", 3))  # lower case: fixed axes
        i, j, k, w = rotation.as_quat().tolist()
        quaternion: Quaternion = (i, j, k, w)
        return Placement(position=(x, y, z), quaternion=quaternion)

    def numbers(self, tag: str, attribute: str, default: str, count: int) -> list[float]:
        """The numbers in an attribute of a child element."""
        child = self.element.find(tag)
        text = default if child is None else child.get(attribute, default)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not all(abs(value) < LARGEST_NUMBER for value in values):
            noun = "a finite number" if count == 1 else f"{count} finite numbers"
            raise self.error(f"{tag} {attribute} is {text[:40]!r}, expected {noun}", "correct it")
        return values

    def error(self, what: str, remedy: str) -> InputError:
        """An InputError located at this element."""
        return InputError(what=what, where=f"{self.file}, {self.called}", remedy=remedy)


class _JointElement(_Element):
    """One joint of the file."""

    def __init__(self, element: ElementTree.Element, file: str) -> None:
        super().__init__(element, file, f"joint '{element.get('name', '')}'")

    @property
    def kind(self) -> JointKind | None:
        """The kind of a movable joint; None of a fixed one."""
        kind = self.element.get("type", "")
        if kind != FIXED and kind not in MOVABLE_JOINTS:
            raise self.error(
                f"its type is '{kind}'", "only revolute, continuous, prismatic and fixed joints are supported"
            )
        if self.element.find("mimic") is not None:
            raise self.error("it mimics another joint", "give it a coordinate of its own, or fix it")
        return MOVABLE_JOINTS.get(kind)

    @property
    def axis(self) -> Vector3:
        """The unit axis; x by default."""
        axis = np.array(self.numbers("axis", "xyz", "1 0 0", 3))
        length = float(np.linalg.norm(axis))
        if length < np.finfo(float).tiny:
            raise self.error("its axis has no direction", "correct its <axis>")
        x, y, z = (axis / length).tolist()
        return (x, y, z)

    def joint(self, kind: JointKind, placement: Placement) -> Joint:
        """The joint at this placement on the frame of the preceding movable joint, with its stated limits."""
        (low,), (high,) = self.numbers("limit", "lower", "0", 1), self.numbers("limit", "upper", "0", 1)
        (speed,) = self.numbers("limit", "velocity", "0", 1)
        bounded = self.element.get("type") != "continuous" and low < high
        return Joint(
            name=self.element.get("name", ""), kind=kind, placement=placement, axis=self.axis,
            position=(low, high) if bounded else None, velocity=(-speed, speed) if speed > 0 else None,
        )  # fmt: skip
