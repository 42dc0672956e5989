"""Column recognition: the wrench, the motion and the rest among the tables' columns, by a map, else by names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.reading.column_map import VECTORS, ColumnMap, name_and_unit
from estimation.reading.column_pattern import PATTERNS, ColumnPattern, Quantity
from estimation.reading.gravity_vector import RATES, has_steady_length
from estimation.reading.log_reader import NO_WRENCH, ROS_TOPIC, TF_CHAIN, Array, LogTable
from estimation.reading.orientation_form import UPWARD, OrientationForm
from modeling.errors import InputError, cut, quoted
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS

MOST_NAMES, SHOWN_PARTS = 8, 3
"""Columns that a message names, and parts of a vector; of more the first and the last."""
FEWEST_OF_MOTION = {3: 2, 6: 3}
"""Columns beside a wrench of so many channels: of a time and an angle in the plane, of a rotation vector in space."""
LEAST_SHARE = 0.5
"""Of a vector's columns that are there, below which its name is chance."""


def columns_by_stem(pattern: ColumnPattern, table: LogTable) -> dict[str, dict[str, str]]:
    """Columns of a table that match a pattern, by stem and part."""
    by_stem: dict[str, dict[str, str]] = {}
    for name in table.columns:
        names = (table.called[name], name) if name in table.called else (name,)
        match = next(filter(None, (pattern.matched(name_and_unit(one)[0]) for one in names)), None)
        if match is not None:
            by_stem.setdefault(match[0].lower(), {}).setdefault(match[1], name)
    return by_stem


@dataclass(frozen=True)
class IncompleteVector:
    """Columns that are there, and the names that lack."""

    present: tuple[str, ...]
    missing: tuple[str, ...]

    @property
    def share(self) -> float:
        """Of the columns that are there."""
        return len(self.present) / (len(self.present) + len(self.missing))

    def __str__(self) -> str:
        present, missing = (tuple(map(cut, names)) for names in (self.present, self.missing))
        shown = present if len(present) <= SHOWN_PARTS else (present[0], "..", present[-1])
        verb = "is" if len(missing) == 1 else "are"
        listed = ", ".join(shown).replace(", .., ", " .. ")
        return f"beside {listed}, {', '.join(missing)} {verb} missing"


def nearest_vector(tables: Iterable[LogTable], quantities: Sequence[Quantity]) -> IncompleteVector | None:
    """The incomplete vector of these quantities that lacks least, the best pattern first; None without any."""
    patterns = [p for p in PATTERNS if p.quantity in quantities and len(p.parts) > 2]
    nearest = [
        incomplete
        for pattern in patterns
        for table in tables
        for members in columns_by_stem(pattern, table).values()
        if (incomplete := _incomplete(pattern, members)) is not None
    ]
    return max((v for v in nearest if v.share > LEAST_SHARE), key=lambda v: v.share, default=None)


def _incomplete(pattern: ColumnPattern, members: dict[str, str]) -> IncompleteVector | None:
    """What of a pattern's parts is there; None where all are, or numbers beyond them."""
    parts = pattern.parts
    if parts[0] == "0" and "0" not in members and str(len(parts)) in members:
        parts = tuple(str(int(number) + 1) for number in parts)
    lacking = [component for component in parts if component not in members]
    if not lacking or not set(members) <= set(parts):
        return None
    present = tuple(members[component] for component in parts if component in members)
    return IncompleteVector(present, tuple(_name_of(pattern, component, members) for component in lacking))


def _name_of(pattern: ColumnPattern, component: str, members: dict[str, str]) -> str:
    """The name that a column would have: that of another part of its kind, with its own part in the other's place."""
    for other, name in members.items():
        match = re.fullmatch(pattern.regex, name, re.IGNORECASE)
        if match is not None and other[:-1] == component[:-1]:
            start, end = match.span("part")
            return name[:start] + component[-(end - start) :] + name[end:]
    return component


COMMANDED = re.compile(
    r"target|desired|command|setpoint|goal|reference|(?:^|[^a-z])(?:cmd|ref|des|action)(?:[^a-z]|$)", re.IGNORECASE
)
DRIVERS_WORK = {
    "compensated by the driver": r"(?:^|[^n])compensat|external|contact|without|\b(?:ext|comp|tared|zeroed)\b",
    "filtered": r"(?:^|[^n])filter|smooth|averag|low ?pass|throttl|decimat|downsampl",
    "not called raw": r"^(?!.*(?:\braw\b|unfilter|uncompensat))",
}
"""What a wrench's topic is called where a driver worked on it: one that takes out the weight, or lags, serves less."""
TABLES = {
    Quantity.WRENCH: ("wrench", "planar_wrench"),
    Quantity.POSE: ("quaternion",),
    Quantity.ORIENTATION: ("quaternion",),
    Quantity.POSITION: ("position",),
    Quantity.RATE: ("angular_velocity",),
}
"""Names of a map under which a quantity's topic, sheet or file may stand."""
ASK = "name its columns in a map"
EXAMPLES = {
    Quantity.WRENCH: 'fx = "column", ...',
    Quantity.POSE: 'orientation_columns = ["column", ...] with orientation = "rotation_vector", or qx = "column", ...',
}
"""Of a map, by what is missing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ColumnGroup:
    """Columns of one table that are one quantity, under the names `targets` of a recording where they have some.

    `why` says why it was chosen of several.
    """

    quantity: Quantity
    table: LogTable
    columns: tuple[str, ...]
    targets: tuple[str, ...] = ()
    form: OrientationForm | None = None
    stem: str = ""
    base_axes: bool = False
    compensated: bool = False
    preset: str = ""
    why: str = ""

    def values(self) -> Array:
        """The columns (n, k), as found."""
        return np.stack([self.table.columns[name] for name in self.columns], axis=1)

    @property
    def title(self) -> str:
        """Table and columns, for a message."""
        first, last = cut(self.columns[0]), cut(self.columns[-1])
        shown = first if len(self.columns) == 1 else f"{first} .. {last}"
        return f"{shown} of {self.table.name}"


@dataclass(frozen=True, kw_only=True, eq=False)
class ColumnMapping:
    """What is read of all tables: wrench; motion as an orientation, with or without a position, or as joints.

    With gravity or an accelerometer for an orientation, the angular velocity of a gyroscope, where there is one; and
    further signals that a map names of tables of which nothing else is read.
    """

    wrench: ColumnGroup
    orientation: ColumnGroup | None
    position: ColumnGroup | None
    joints: tuple[ColumnGroup, ...]
    rate: ColumnGroup | None = None
    signals: tuple[ColumnGroup, ...] = ()

    @property
    def groups(self) -> tuple[ColumnGroup, ...]:
        """All groups, the wrench first."""
        groups = (self.wrench, self.orientation, self.position, *self.joints, self.rate, *self.signals)
        return tuple(group for group in groups if group is not None)

    @property
    def is_level(self) -> bool:
        """Whether the turn about the vertical is unknown: of gravity or an accelerometer for an orientation."""
        form = None if self.orientation is None else self.orientation.form
        return form is not None and form.name in UPWARD


def column_mapping(tables: Sequence[LogTable], stated: ColumnMap, joint_names: Sequence[str] | None) -> ColumnMapping:
    """The mapping of these tables. `joint_names` are those of the rig's arm, in order; None without an arm.

    Raises InputError where something is missing, or two groups of columns could be it.
    """
    mapping = _wrench_and_motion(tables, stated, joint_names)
    return replace(mapping, signals=_Groups(tables, stated).signals(mapping))


def _wrench_and_motion(
    tables: Sequence[LogTable], stated: ColumnMap, joint_names: Sequence[str] | None
) -> ColumnMapping:
    groups = _Groups(tables, stated)
    for reference in (*stated.columns.values(), *stated.orientation):
        if not any(reference in table.columns for table in tables):
            groups.place(reference)  # an error, or a qualified name
    wrench = groups.stated_vector(Quantity.WRENCH, SPATIAL_CHANNELS) or groups.stated_vector(
        Quantity.WRENCH, PLANAR_CHANNELS
    )
    wrench = wrench or groups.wrench()
    if wrench is None:
        if all(table.kind in (ROS_TOPIC, TF_CHAIN) and table.wrench_frame is None for table in tables):
            raise groups.without_wrench()
        raise groups.error("no wrench is recognised", (Quantity.WRENCH,), groups.incomplete_wrench())
    frame = wrench.table.wrench_frame
    groups = replace(groups, tables=[t for t in tables if t.kind != TF_CHAIN or t.wrench_frame == frame])
    joints = groups.joints(joint_names)
    if joints and (joint_names is not None or not stated.orientation):
        orientation = None if joint_names is not None else groups.orientation()
        if orientation is None:
            return ColumnMapping(wrench=wrench, orientation=None, position=None, joints=joints)
    else:
        orientation = groups.orientation()
    if orientation is None and len(wrench.columns) == len(SPATIAL_CHANNELS):
        orientation, rate = groups.vertical()
        if orientation is not None:
            return ColumnMapping(wrench=wrench, orientation=orientation, position=None, joints=(), rate=rate)
    if orientation is None:
        if groups.nothing_beside(wrench):
            raise groups.without_motion(wrench)
        what = "no motion is recognised: neither an orientation nor joint angles"
        raise groups.error(what, (Quantity.POSE, Quantity.ORIENTATION))
    if orientation.form is not None and orientation.form.name in UPWARD:
        rate = groups.rate(orientation)
        return ColumnMapping(wrench=wrench, orientation=orientation, position=None, joints=(), rate=rate)
    return ColumnMapping(wrench=wrench, orientation=orientation, position=groups.position(orientation), joints=())


@dataclass(frozen=True)
class _Groups:
    """The complete groups of columns in the tables, as a map states them, else as the patterns find them."""

    tables: Sequence[LogTable]
    stated: ColumnMap

    def error(self, what: str, quantities: Sequence[Quantity], hint: str = "") -> InputError:
        """That something is missing: the nearest of these quantities names what lacks, else the columns are named."""
        where = ", ".join(table.name for table in self.tables[:3])
        near = nearest_vector(self.tables, quantities)
        closest = self.nearest() + hint if near is None or hint else f": {near}"
        return InputError(
            what=what + closest, where=where, remedy=f"{ASK}: {EXAMPLES[quantities[0]]}, and give it by --map"
        )

    def nothing_beside(self, wrench: ColumnGroup) -> bool:
        """Whether no columns are left that could be a motion beside a time."""
        others = [name for table in self.tables for name in table.columns if name not in wrench.columns]
        in_bags = all(table.kind in (ROS_TOPIC, TF_CHAIN) for table in self.tables)
        return len(others) < FEWEST_OF_MOTION[len(wrench.columns)] or in_bags

    def without_motion(self, wrench: ColumnGroup) -> InputError:
        """The error of logs that have a wrench alone: no map helps."""
        has = f"; its topics are {self._topics()}" if wrench.table.kind == ROS_TOPIC else ""
        frame = f" of {wrench.table.wrench_frame}" if wrench.table.wrench_frame else ""
        because = f": {wrench.table.without_pose}" if wrench.table.without_pose else ""
        remedy = (
            f"record the pose{frame} (PoseStamped, or /tf and /tf_static up to it), joint states, or the sensor's Imu"
            if has
            else "log its pose, joint angles, or an accelerometer beside it, or give the robot's log as a second source"
        )
        what = f"a wrench, and nothing that tells how the sensor was turned or moved{because}{has}"
        return InputError(what=what, where=wrench.table.name.partition(":")[0], remedy=remedy)

    def _topics(self) -> str:
        """The topics of bags, with those that are not read, for a message."""
        topics = [table.name.partition(":")[2] for table in self.tables]
        unread = [topic for table in self.tables for topic in table.unread]
        return ", ".join(dict.fromkeys([*topics, *unread]))

    def without_wrench(self) -> InputError:
        """The error of bags in which nobody published a wrench, with the topics that they have."""
        remedy = "record the sensor's topic, too, or give its log beside the bag"
        return InputError(
            what=f"{NO_WRENCH}; its topics are {self._topics()}",
            where=self.tables[0].name.partition(":")[0],
            remedy=remedy,
        )

    def nearest(self) -> str:
        """The columns that there are, for a message."""
        names = [name for table in self.tables for name in table.columns]
        return f" among {', '.join(map(cut, names[:MOST_NAMES]))}" + (
            f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
        )

    def incomplete_wrench(self) -> str:
        """What of a wrench there is and what lacks, for a message; empty where there is nothing of one."""
        names = {name for table in self.tables for name in table.columns}
        present = [c for c in dict.fromkeys((*SPATIAL_CHANNELS, *PLANAR_CHANNELS)) if c in names]
        lacking = [[c for c in channels if c not in names] for channels in (PLANAR_CHANNELS, SPATIAL_CHANNELS)]
        if not present or not all(lacking):
            return ""
        planar, spatial = (", ".join(channels) for channels in lacking)
        outside = "tau" not in present and not {"fx", "fy"}.issuperset(present)
        return f": beside {', '.join(present)} it lacks {spatial if outside else f'{planar}, or {spatial} in six axes'}"

    # ------------------------------------------------------------------------------ as the map says

    def place(self, reference: str) -> tuple[LogTable, str]:
        """Table and column of a map's reference: the column's name, or `table:column` where two tables have it."""
        places = [(table, reference) for table in self.tables if reference in table.columns]
        if not places:
            places = [
                (table, name)
                for table in self.tables
                for name in table.columns
                if reference in (f"{table.name}:{name}", f"{table.name.rsplit('.', 1)[0]}:{name}")
            ]
        if len(places) == 1:
            return places[0]
        if places:
            what = f"column {quoted(reference)} occurs in {' and '.join(table.name for table, _ in places)}"
            raise InputError(what=what, where=self.stated.where, remedy=f'write "{places[0][0].name}:{reference}"')
        what = f"there is no column {quoted(reference)}"
        raise InputError(what=what + self.nearest(), where=self.stated.where, remedy="correct the map")

    def of_columns(self, quantity: Quantity, references: Sequence[str], targets: Sequence[str]) -> ColumnGroup:
        """The group of these columns, which have to be in one table."""
        places = [self.place(reference) for reference in references]
        if len({id(table) for table, _ in places}) > 1:
            what = f"the columns of the {quantity.value} are in different sources"
            raise InputError(what=what, where=self.stated.where, remedy="name columns of one source for it")
        names = tuple(name for _, name in places)
        return ColumnGroup(quantity=quantity, table=places[0][0], columns=names, targets=tuple(targets))

    def stated_vector(self, quantity: Quantity, targets: tuple[str, ...]) -> ColumnGroup | None:
        """The group that the map names for these targets; None when it names none of them."""
        named = [target for target in targets if target in self.stated.columns]
        if not named or ("tau" in targets) != ("tau" in self.stated.columns):
            return None
        missing = [target for target in targets if target not in named]
        if missing:
            what = f"the map names {', '.join(named)}, and not {', '.join(missing)}"
            raise InputError(what=what, where=self.stated.where, remedy="name all columns of a vector")
        return self.of_columns(quantity, [self.stated.columns[target] for target in targets], targets)

    # ------------------------------------------------------------------------------------ by name

    def candidates(self, quantity: Quantity) -> list[ColumnGroup]:
        """The complete groups of a quantity, best pattern first, measured before commanded ones."""
        patterns = [pattern for pattern in PATTERNS if pattern.quantity is quantity and pattern.parts]
        tables = self.stated_tables(quantity)
        groups = [group for pattern in patterns for table in tables for group in _matches(pattern, table)]
        return sorted(groups, key=lambda group: bool(COMMANDED.search(group.title)))

    def stated_tables(self, quantity: Quantity) -> Sequence[LogTable]:
        """The tables of which a quantity is to be: the one that the map names for it, else all."""
        stated = [self.stated.tables[key] for key in TABLES.get(quantity, ()) if key in self.stated.tables]
        if not stated:
            return self.tables
        tables = [t for t in self.tables if stated[0] in (t.name, t.name.partition(":")[2])]
        if not tables:
            names = ", ".join(table.name.partition(":")[2] or table.name for table in self.tables[:MOST_NAMES])
            what = f"there is no topic, sheet or file {quoted(stated[0])} among {names}"
            raise InputError(what=what, where=self.stated.where, remedy="correct the map")
        return tables

    def wrench(self) -> ColumnGroup | None:
        """The only wrench, or the best; InputError when two are equally good.

        Of several topics the one is taken on which the driver worked least, by their names, then one whose frame's pose
        tf tells.
        """
        groups = [group for group in self.candidates(Quantity.WRENCH) if _is_alive(group)]
        groups = [g if not _is_worked_on(g) else replace(g, compensated=True) for g in groups]
        topics = [group for group in groups if group.table.kind == ROS_TOPIC]
        if not groups or groups[0] not in topics or len(topics) < 2:
            return self.only(groups)
        topics.sort(key=_worked_on)
        best, second = topics[:2]
        if _worked_on(best) == _worked_on(second):
            both = " or ".join(_topic(group) for group in (best, second))
            remedy = f'state it in a map: wrench = "{_topic(best)}"'
            raise InputError(what=f"the wrench could be that of {both}", where=best.table.name, remedy=remedy)
        kinds = ["commanded", *DRIVERS_WORK, "without its frame's pose in tf"]
        others = [(_topic(g), next(k for k, a, b in zip(kinds, _worked_on(g), _worked_on(best), strict=True) if a > b))
                  for g in topics[1:]]  # fmt: skip
        why = f"of {len(topics)} topics with a wrench: {', '.join(f'{name} is {kind}' for name, kind in others)}"
        return replace(best, why=why)

    def only(self, groups: Sequence[ColumnGroup]) -> ColumnGroup | None:
        """The first group; InputError when the next one is as good a reading."""
        if not groups:
            return None
        best = groups[0]
        rivals = [
            g
            for g in groups[1:]
            if (g.preset, bool(COMMANDED.search(g.title))) == (best.preset, bool(COMMANDED.search(best.title)))
        ]
        rivals = [g for g in rivals if g.targets == best.targets and not g.preset]
        topics = [g for g in rivals if g.table is not best.table and {g.table.kind, best.table.kind} == {ROS_TOPIC}]
        if topics and topics[0].columns == best.columns:
            key = next(iter(TABLES.get(best.quantity, ())), "")
            remedy = f'state it in a map: {key} = "{_topic(best)}"' if key else f"{ASK}, and give it by --map"
            what = f"the {best.quantity.value} could be that of {_topic(best)} or {_topic(topics[0])}"
            raise InputError(what=what, where=best.table.name, remedy=remedy)
        rivals = [g for g in rivals if g.columns != best.columns]
        if rivals:
            what = f"the {best.quantity.value} could be {best.title} or {rivals[0].title}"
            raise InputError(what=what, where=best.table.name, remedy=f"{ASK}, and give it by --map")
        return best

    def orientation(self) -> ColumnGroup | None:
        """The orientation's columns, with those of a pose that holds it."""
        if self.stated.orientation:
            group = self.of_columns(Quantity.ORIENTATION, self.stated.orientation, ("qx", "qy", "qz", "qw"))
            form = self.stated.form or OrientationForm("xyzw")
            return ColumnGroup(**{**vars(group), "form": form})
        if "phi" in self.stated.columns:
            group = self.of_columns(Quantity.ORIENTATION, [self.stated.columns["phi"]], ("phi",))
            return ColumnGroup(**{**vars(group), "form": OrientationForm("planar")})
        both = [*self.candidates(Quantity.POSE), *self.candidates(Quantity.ORIENTATION)]
        order = {pattern: place for place, pattern in enumerate(PATTERNS)}
        both.sort(key=lambda g: (bool(COMMANDED.search(g.title)), not g.preset, g.table.kind != TF_CHAIN))
        there = [g for g in both if _has_samples(g)]
        beyond_doubt = [
            g for g in there if g.form is None or not g.form.angles
        ]  # whose axes the name does not leave open
        chosen = self.only(beyond_doubt or there) if order else None
        if chosen is not None and self.stated.form is not None and len(chosen.columns) in self.stated.form.columns:
            chosen = ColumnGroup(**{**vars(chosen), "form": self.stated.form})
        return chosen

    def vertical(self) -> tuple[ColumnGroup | None, ColumnGroup | None]:
        """Gravity or an accelerometer, where there is no pose, and the gyroscope beside it.

        Columns gx, gy, gz are gravity where they have its length, else a gyroscope beside an accelerometer.
        """
        found = [group for group in self.candidates(Quantity.VERTICAL) if _has_samples(group)]
        gravity = [g for g in found if g.form == OrientationForm("gravity") and has_steady_length(g.values())]
        accelerometers = [g for g in found if g.form == OrientationForm("accelerometer")]
        chosen = self.only(gravity) or self.only(accelerometers)
        return chosen, None if chosen is None else self.rate(chosen)

    def rate(self, vertical: ColumnGroup) -> ColumnGroup | None:
        """The gyroscope beside an accelerometer, or beside gravity; None without one."""
        stated = self.stated_vector(Quantity.RATE, RATES)
        if stated is not None:
            return stated
        named_g = [g for g in self.candidates(Quantity.VERTICAL) if g.form == OrientationForm("gravity")]
        rates = [*self.candidates(Quantity.RATE), *(g for g in named_g if not has_steady_length(g.values()))]
        rates = [
            replace(g, quantity=Quantity.RATE, targets=RATES, form=None) for g in rates if g.table is vertical.table
        ]
        return self.only([group for group in rates if _is_alive(group) and group.columns != vertical.columns])

    def position(self, orientation: ColumnGroup) -> ColumnGroup | None:
        """The position that belongs to the orientation: of the map, else of the same pose; None without one."""
        stated = self.stated_vector(Quantity.POSITION, ("px", "py", "pz"))
        if stated is not None or orientation.quantity is Quantity.POSE or orientation.form == OrientationForm("planar"):
            return stated
        same = [g for g in self.candidates(Quantity.POSITION) if g.table is orientation.table]
        same = [g for g in same if set(g.columns).isdisjoint(orientation.columns)]
        plain = [g for g in same if g.stem == orientation.stem] or [
            g for g in same if re.search(r"pos|translation|p[^a-z]*$", g.columns[0].lower().removesuffix("x"))
        ]
        return next(iter(plain), None)

    def signals(self, mapping: ColumnMapping) -> tuple[ColumnGroup, ...]:
        """Columns that the map names of tables of which the mapping reads nothing, a group a table."""
        used = {id(group.table) for group in mapping.groups}
        members: dict[int, list[tuple[LogTable, str, str]]] = {}
        for target, reference in self.stated.columns.items():
            if re.fullmatch(r"time|phi|q\d+", target) or any(target in names for names in VECTORS.values()):
                continue
            table, column = self.place(reference)
            if id(table) not in used:
                members.setdefault(id(table), []).append((table, column, target))
        return tuple(
            ColumnGroup(
                quantity=Quantity.SIGNAL, table=own[0][0],
                columns=tuple(c for _, c, _ in own), targets=tuple(t for _, _, t in own),
            )
            for own in members.values()
        )  # fmt: skip

    def joints(self, names: Sequence[str] | None) -> tuple[ColumnGroup, ...]:
        """Groups of joint angles with the targets q1 .. qn; several where several sources hold some each."""
        stated = [key for key in self.stated.columns if re.fullmatch(r"q[1-9]\d*", key)]
        if stated:
            stated.sort(key=lambda key: int(key[1:]))
            return (self.of_columns(Quantity.JOINTS, [self.stated.columns[key] for key in stated], stated),)
        named = self._named_joints(names)
        if named:
            return named
        patterns = [p for p in PATTERNS if p.quantity is Quantity.JOINTS and "joint:" not in p.regex]
        groups = [group for pattern in patterns for table in self.tables for group in _numbered(pattern, table)]
        groups = [g for g in groups if names is None or len(g.columns) == len(names)]
        groups.sort(key=lambda g: bool(COMMANDED.search(g.title)))
        return tuple(groups[:1])

    def _named_joints(self, names: Sequence[str] | None) -> tuple[ColumnGroup, ...]:
        """Joints by the names that ROS gives them, in the order of the rig's arm, else in that of their names."""
        places = {c.split(":", 1)[1]: (t, c) for t in self.tables for c in t.columns if c.startswith("joint:")}
        order = [name for name in (names or sorted(places)) if name in places]
        if not order or (names is not None and len(order) < len(names)):
            return ()
        groups: dict[int, list[tuple[LogTable, str, str]]] = {}
        for number, name in enumerate(order, 1):
            groups.setdefault(id(places[name][0]), []).append((*places[name], f"q{number}"))
        return tuple(
            ColumnGroup(
                quantity=Quantity.JOINTS, table=members[0][0],
                columns=tuple(c for _, c, _ in members), targets=tuple(t for _, _, t in members),
            )
            for members in groups.values()
        )  # fmt: skip


def _has_samples(group: ColumnGroup) -> bool:
    complete = np.ones(group.table.rows, dtype=bool)
    for name in group.columns:
        complete &= np.isfinite(group.table.columns[name])
    return bool(complete.any())


def _topic(group: ColumnGroup) -> str:
    return group.table.name.partition(":")[2]


def _words(group: ColumnGroup) -> str:
    """The name of a topic in words, for a pattern."""
    return re.sub(r"[^a-z]+", " ", _topic(group).lower())


def _is_worked_on(group: ColumnGroup) -> bool:
    """Whether a topic's name says that the driver takes out a payload's weight."""
    return group.table.kind == ROS_TOPIC and bool(re.search(next(iter(DRIVERS_WORK.values())), _words(group)))


def _worked_on(group: ColumnGroup) -> tuple[bool, ...]:
    """How little a topic serves, in the order of what counts most: by its name, then for want of a pose."""
    name = _words(group)
    called = [bool(re.search(pattern, name)) for pattern in DRIVERS_WORK.values()]
    return bool(COMMANDED.search(name)), *called, bool(group.table.without_pose)


def _is_alive(group: ColumnGroup) -> bool:
    """Whether any of its columns changes."""
    columns = [group.table.columns[name] for name in group.columns]
    return any(bool(np.fmax.reduce(column) > np.fmin.reduce(column)) for column in columns)


def _matches(pattern: ColumnPattern, table: LogTable) -> list[ColumnGroup]:
    """The complete groups of a pattern in a table; numbered parts may begin at 1."""
    groups = []
    for stem, members in columns_by_stem(pattern, table).items():
        parts = pattern.parts
        if parts[0] == "0" and "0" not in members and str(len(parts)) in members:
            parts = tuple(str(int(number) + 1) for number in parts)
        numbers = [component for component in members if component.isdigit()]
        if not all(component in members for component in parts) or (parts[0].isdigit() and len(numbers) > len(parts)):
            continue
        groups.append(_group(pattern, table, stem, tuple(members[component] for component in parts)))
    return groups


def _group(pattern: ColumnPattern, table: LogTable, stem: str, columns: tuple[str, ...]) -> ColumnGroup:
    targets = {
        Quantity.WRENCH: PLANAR_CHANNELS if len(columns) == 3 else SPATIAL_CHANNELS,
        Quantity.POSITION: ("px", "py", "pz"),
    }.get(pattern.quantity, ("qx", "qy", "qz", "qw"))
    form = OrientationForm(*pattern.form.split()) if pattern.form else None
    return ColumnGroup(
        quantity=pattern.quantity, table=table, columns=columns, targets=targets, form=form, stem=stem,
        base_axes=pattern.base_axes, compensated=pattern.compensated, preset=pattern.preset,
    )  # fmt: skip


def _numbered(pattern: ColumnPattern, table: LogTable) -> list[ColumnGroup]:
    """Joint angles numbered from 0 or 1 on without a gap, or by names."""
    groups = []
    for stem, members in columns_by_stem(pattern, table).items():
        numeric = all(component.isdigit() for component in members)
        parts = sorted(members, key=int) if numeric else sorted(members)
        if numeric and (
            [int(p) for p in parts] != list(range(int(parts[0]), int(parts[0]) + len(parts))) or int(parts[0]) > 1
        ):
            continue
        columns = tuple(members[component] for component in parts)
        targets = tuple(f"q{i}" for i in range(1, len(parts) + 1))
        groups.append(
            ColumnGroup(
                quantity=Quantity.JOINTS,
                table=table,
                columns=columns,
                targets=targets,
                stem=stem,
                preset=pattern.preset,
            )
        )
    return groups
