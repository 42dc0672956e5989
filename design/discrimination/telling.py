"""Telling apart: from a model at its values and its rivals to the motion that separates them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from design.discrimination.direction import Direction
from design.discrimination.distinction import Distinction
from design.discrimination.hypothesis import Hypothesis
from design.discrimination.imitation import Imitation
from design.discrimination.pair import CONFUSABLE, Pair, Separation
from design.discrimination.search import Progress, Round, Search
from design.discrimination.setting import Setting
from design.discrimination.view import View
from design.information.noise import SensorNoise
from design.information.values import Values
from design.motion.series import Motion, Series
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.rig import Rig

STARTS = 4
"""Random motions from which the search starts."""
PROBES = 4
"""Random motions that show what any motion shows (almost surely), where readings are analytic in the motion."""
HOPELESS = 1000
"""A pair that would need so many times the runs along random motions is not designed for while others need less: a
designed motion saves a factor of ten or so (3 to 20, once 70: `benchmarks.tell_apart`), and nobody makes the rest in
runs."""
TYPICAL = 9
"""Random motions whose median lambda stands for a motion that was not designed."""
ROUNDING = 1e-8
"""An effect is imitated exactly when less than this share of its whitened length is left. Rounding leaves 1e-14, a
search that ends at 1e-12 of the parameters a little more; the nearest rivals of the catalogue that do differ, a lag and
a delay, differ by half their time times the motion's rad/s: 1e-2 at 8 ms."""


@dataclass(frozen=True, eq=False)
class Before:
    """The motions that there were before: one that is given, or random ones that stand for any."""

    views: tuple[View, ...]
    words: str

    @classmethod
    def of(cls, setting: Setting, reference: Motion | View | None, randoms: Sequence[Motion]) -> Before:
        """The reference, without one the random motions."""
        if reference is None:
            return cls(tuple(map(setting.view, randoms)), f"median of {len(randoms)} random motions")
        view = setting.view(reference) if isinstance(reference, Motion) else reference
        return cls((view,), "the motion given")


@dataclass(frozen=True, eq=False)
class Contest:
    """A direction and its best imitation along all motions before.

    before    lambda along one of them, their median
    typical   lambda along a random motion, with the readings that motions are optimised with
    imitated  whether the imitation is exact, along any motion
    """

    direction: Direction
    begin: Imitation
    before: float
    typical: float
    imitated: bool

    @classmethod
    def of(cls, direction: Direction, before: Before, probes: Sequence[View], reach: float) -> Contest:
        """With lambda the median of the motions before, and exactness judged along the probes."""
        begin = direction.imitation(before.views, reach)
        single = [direction.imitation([view], reach, [begin.theta]).separation for view in before.views]
        power = direction.power(probes)
        left = direction.imitation(probes, reach, [begin.theta]).separation
        exact = direction.contained or left <= ROUNDING**2 * power
        return cls(direction, begin, float(np.median(single)), left / len(probes), exact)


def tell_apart(
    rig: Rig,
    truth: WrenchModel,
    values: Values,
    rivals: Sequence[WrenchModel],
    *,
    series: Series,
    samples: int,
    noise: SensorNoise,
    reference: Motion | View | None = None,
    runs: int = 1,
    starts: int = STARTS,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Distinction:
    """The motion of a series, within the limits of the rig, that separates a model from each of its rivals.

    truth, values  the model that is believed, its parameters by name: at the sizes in a model file, or of a fit
    rivals         what else it might be (`in_place_of`, `opponents`); their size is that of their best imitation of
                   the truth along the reference
    samples        equally spaced readings of one run, of `noise`
    reference      the motion that could not tell them apart, or a `View` of its signals; without one, sizes are those
                   of the best imitation along some random motions together, and lambda before is the random median
    runs           how often the motion is run
    executor       works on the starts elsewhere (processes; see `optimise`)

    Both directions count: the rival's imitation of the truth and, with the rival true, the truth's of it. A pair that
    no motion separates in any number of runs that somebody would make does not decide which motion is best for others.
    Raises InputError for a rig without arm or limits, an effect of one recording, a signal that joints do not give, and
    values that give the truth no more than a rival has.
    """
    setting = Setting.of(rig, series=series, samples=samples, noise=noise)
    truth, *rivals = (model.of_arm(setting.arm) for model in (truth, *rivals))
    setting.require([truth, *rivals])
    randoms = [setting.random((seed, 0, number)) for number in range(TYPICAL)]
    probes = tuple(setting.view(motion, setting.coarse) for motion in randoms[:PROBES])
    before = Before.of(setting, reference, randoms)
    believed = Hypothesis.of(truth, values)
    pairs = [_contests(Direction(believed, rival), before, probes, setting.reach) for rival in rivals]
    undecided = [contest for pair in pairs for contest in pair if not contest.imitated]
    rounds: list[Round] = []
    if undecided:
        sought = _within_reach(undecided, runs * samples / setting.coarse)
        search = Search(
            setting=setting, directions=tuple(c.direction for c in sought), probes=probes, executor=executor
        )
        rounds = search.run([c.begin for c in sought], starts=starts, seed=seed, progress=progress)
    best = max(rounds, key=lambda found: found.smallest, default=None)
    after = {} if best is None else dict(zip(undecided, _exact(setting, best.motion, undecided), strict=True))
    return Distinction(
        setting=setting,
        motion=None if best is None else best.motion,
        pairs=tuple(Pair(directions=_separations(pair, after, runs), runs=runs) for pair in pairs),
        runs=runs,
        reference=before.words,
        rounds=tuple(rounds),
    )


def _contests(forward: Direction, before: Before, probes: Sequence[View], reach: float) -> tuple[Contest, Contest]:
    """A direction and its reverse, in which the rival is true at the size of its best imitation."""
    if not forward.power(probes) and not forward.contained:
        what = f"at the values given, {forward.names[0]} changes nothing that is read"
        raise InputError(what=what, where="effects to be told apart", remedy="give its values, from a fit")
    contest = Contest.of(forward, before, probes, reach)
    reverse = Direction(Hypothesis(forward.rival, contest.begin.theta), forward.truth.model)
    other = Contest.of(reverse, before, probes, reach)
    return contest, replace(other, imitated=True) if forward.contained else other  # which then are the same


def _within_reach(undecided: Sequence[Contest], readings: float) -> list[Contest]:
    """Those that a designed motion may decide, all when there is none; `readings` is how many times lambda counts."""
    hopeful = [c for c in undecided if HOPELESS * readings * c.typical > CONFUSABLE]
    return hopeful or list(undecided)


def _exact(setting: Setting, motion: Motion, undecided: Sequence[Contest]) -> list[tuple[float, float]]:
    """lambda of each truth from its rival, and from nothing in its place, along a motion, of all readings of a run."""
    views, reach = [setting.view(motion)], setting.reach
    return [
        (
            contest.direction.imitation(views, reach, [contest.begin.theta]).separation,
            contest.direction.alone.imitation(views, reach).separation,
        )
        for contest in undecided
    ]


def _separations(
    pair: tuple[Contest, Contest], after: dict[Contest, tuple[float, float]], runs: int
) -> tuple[Separation, Separation]:
    one, other = (
        Separation(
            truth=contest.direction.names[0],
            rival=contest.direction.names[1],
            before=runs * contest.before,
            after=runs * after.get(contest, (0.0, 0.0))[0],
            noticed=runs * after.get(contest, (0.0, 0.0))[1],
            imitated=contest.imitated,
        )
        for contest in pair
    )
    return one, other
