"""Effects that one recording cannot tell apart, told apart by a designed one: `python -m benchmarks.discrimination`.

An effect is hidden in the rig that MuJoCo simulates, which shares no equation with the models. An ordinary motion, slow
and small, is recorded and diagnosed. What the diagnosis names is then told from what it calls confusable, and nothing
else is known to the design (`diagnosis.next_experiment`): the motion designed is recorded as often and diagnosed anew,
and so is a random motion of the same series, as large as the same limits allow. Right is the hidden effect alone;
settled is right, with no rival confusable.

lambda is that of the hidden effect at its true size from its rival; promised is what the plan made of the size that
the first recording suggested. lambda found is chi-square of the exact fit with the rival less that with the hidden
effect, both over the noise as it is: its mean is the lambda of the truth, its std 2 sqrt(lambda), for models of
equally many parameters.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.design_variance import shown
from design.discrimination import DirectedPair, DiscriminationDesign, Hypothesis, with_effect_replaced
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import random_periodic_trajectory
from design.trajectories.trajectory import Trajectory
from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.next_experiment import next_experiment, recorded_experiment
from estimation.fit import fit
from estimation.model_response import predicted_readings
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar
from modeling.effects import named
from modeling.errors import InputError
from modeling.noise import NoiseModel
from modeling.rig import Limits, Rig
from truewrench import simulated_rig as simulated

ROBOT = simulated.PlanarRig()
LIMITS = {"position": (1.05, 1.22, 1.40), "velocity": (2.0, 2.2, 3.5), "acceleration": (10.0, 10.0, 15.0)}
SLOW = 0.35
"""Share of these limits that the ordinary motion keeps to."""
PAIRS = np.array([[-1.0, 1.0]])
RIG = Rig(
    name="simulated",
    link_lengths=ROBOT.link_lengths,
    tip_length=0.2,
    limits=Limits(**{name: np.array(values)[:, None] * PAIRS for name, values in LIMITS.items()}),
)
REPEATS, SAMPLES, PERIOD = 6, 250, 5.0
CASES: dict[str, tuple[simulated.HiddenEffect, str]] = {
    "viscous": (simulated.ViscousDrag(c=0.015), "quadratic_drag"),
    "quadratic": (simulated.QuadraticDrag(c=0.01), "viscous_drag"),
    "lag": (simulated.SensorLag(time_constant=0.012), "time_delay"),
    "delay": (simulated.TimeDelay(delay=0.012), "sensor_lag"),
}


@dataclass(frozen=True, eq=False)
class Told:
    """What a diagnosis of one recording says of a hidden effect and its rival."""

    recording: Recording
    diagnosis: Diagnosis
    hidden: str
    rival: str

    @property
    def right(self) -> bool:
        """Whether it names the hidden effect and nothing else."""
        return self.diagnosis.added == (self.hidden,)

    @property
    def wrong(self) -> bool:
        """Whether it names the rival in its place."""
        return self.rival in self.diagnosis.added

    @property
    def settled(self) -> bool:
        """Whether it is right and excludes all others."""
        return self.right and not self.diagnosis.findings[0].confusable_with

    @property
    def separation(self) -> float:
        """lambda found: chi-square with the rival less that with the hidden effect."""
        return self._cost(self.rival) - self._cost(self.hidden)

    def _cost(self, effect_id: str) -> float:
        """Chi-square of the rigid tool with that effect alone, fitted exactly."""
        model = self.diagnosis.model.base + named(effect_id)
        return min(_chi_square(model, self.recording, start) for start in _starts(effect_id))


@dataclass(frozen=True, eq=False)
class Trial:
    """One hidden effect in one ordinary recording, then in the designed motion and in a random one.

    truth  the hidden effect at its true size, against the rival: what the designed motion's lambda really is
    """

    before: Told
    plan: DiscriminationDesign
    designed: Told
    random: Told
    truth: DirectedPair

    @property
    def promised(self) -> float:
        """lambda along the designed motion with the hidden effect true, by the plan: at the size it had to go by."""
        names = (self.before.hidden, self.before.rival)
        found = [d.after for pair in self.plan.pairs for d in pair.directions if (d.truth, d.rival) == names]
        return found[0] if found else np.nan

    def expected(self, told: Told) -> float:
        """lambda along the motion of a recording at the true size."""
        view = recorded_experiment(told.recording, self.plan.setting.noise)
        return told.recording.repeats * self.truth.rival_fit([view], self.plan.setting.reach).noncentrality


def recorded(motion: Trajectory, effect: simulated.HiddenEffect, seed: int) -> Recording:
    """The motion's repeats, with white noise."""
    frame = simulated.simulate(ROBOT, motion, hidden=[effect], repeats=REPEATS, samples_per_period=SAMPLES, seed=seed)
    return from_columns({str(n): frame[n].to_numpy(dtype=float) for n in frame}, name=f"seed {seed}", rig=RIG)


def trial(case: str, seed: int) -> Told | Trial:
    """Record, diagnose, design, record, diagnose; the first diagnosis alone where it leaves nothing to design for.

    The rival is the expected one where the diagnosis is right, else the effect that it names.
    """
    effect, rival = CASES[case]
    limits = {name: tuple(SLOW * value for value in values) for name, values in LIMITS.items()}
    ordinary = random_periodic_trajectory(joints=3, **limits, period=PERIOD, seed=(seed, 0))  # type: ignore[arg-type]
    before = _told(ordinary, effect, rival, 10 * seed)
    others = [name for name in before.diagnosis.added if name != effect.id]
    if others:
        before = replace(before, rival=others[0])
    try:
        plan = next_experiment(before.diagnosis, noise=NoiseModel.white(ROBOT.noise), starts=2, seed=seed)
    except InputError:  # nothing found, or nothing confusable
        return before
    assert plan.motion is not None
    control = random_feasible_trajectory(plan.setting.series, plan.setting.limits, seed=(seed, 1))
    designed, random = (
        _told(motion, effect, before.rival, 10 * seed + i) for i, motion in enumerate((plan.motion, control), start=1)
    )
    return Trial(before, plan, designed, random, _truth(effect, before.rival))


def _truth(effect: simulated.HiddenEffect, rival: str) -> DirectedPair:
    tool = dict(zip(("bias_fx", "bias_fy", "bias_tau"), ROBOT.bias, strict=True))
    tool |= {"m": ROBOT.mass, "mlg": ROBOT.mlg, "I": ROBOT.inertia}
    tool |= {f"{effect.id}.{name}": value for name, value in vars(effect).items()}
    model = planar(RIG) + named(effect.id)
    return DirectedPair(Hypothesis.of(model, tool), with_effect_replaced(model, effect.id, named(rival)))


def _told(motion: Trajectory, effect: simulated.HiddenEffect, rival: str, seed: int) -> Told:
    recording = recorded(motion, effect, seed)
    return Told(recording, diagnose(planar(RIG), recording), effect.id, rival)


def _chi_square(model: WrenchModel, recording: Recording, start: Mapping[str, float]) -> float:
    theta = fit(model, recording, noise=NoiseModel.white(ROBOT.noise), start=start).theta
    left = (recording.wrench - predicted_readings(model, recording, theta)) / np.array(ROBOT.noise)
    return float((left**2).sum())


def _starts(effect_id: str) -> list[dict[str, float]]:
    """Along the tip where the effect has a place there."""
    if not effect_id.endswith("drag"):
        return [{}]
    return [{f"{effect_id}.c": 0.01, f"{effect_id}.d": d} for d in (0.0, 0.1, 0.2)]


def row(case: str, seed: int) -> tuple[str, ...]:
    """What came of one trial, under `HEADS`."""
    found = trial(case, seed)
    if isinstance(found, Told):
        return (case, str(seed), _word(found), *["-"] * (len(HEADS) - 3))
    cells = [case, str(seed)]
    for told in (found.before, found.designed, found.random):
        cells += [_word(told), f"{found.expected(told):.4g}", f"{told.separation:.4g}"]
    return (*cells, f"{found.promised:.4g}")


def _word(told: Told) -> str:
    named_ = "+".join(told.diagnosis.added) or "nothing"
    others = ",".join(told.diagnosis.findings[0].confusable_with) if told.diagnosis.added else ""
    state = "settled" if told.settled else "right" if told.right else "WRONG" if told.wrong else "other"
    return f"{state}: {named_}" + (f" ({others})" if others else "")


MOTIONS = ("ordinary", "designed", "random")
HEADS = ("hidden", "seed", *(head for motion in MOTIONS for head in (motion, "lambda", "found")), "promised")


def counts(rows: Sequence[Sequence[str]]) -> str:
    """Of each case, how often each motion was right, and how often settled, of the trials that led to a design."""
    table: list[tuple[str, ...]] = [("hidden", "trials", *MOTIONS)]
    for case in dict.fromkeys(row[0] for row in rows):
        own = [row for row in rows if row[0] == case and row[-1] != "-"]
        words = [[row[2 + 3 * place].partition(":")[0] for row in own] for place in range(len(MOTIONS))]
        cells = [
            f"{sum(w in ('right', 'settled') for w in said)} right, {said.count('settled')} settled" for said in words
        ]
        table.append((case, str(len(own)), *cells))
    return shown(table)


def main() -> None:
    """Trials of each case, a row each as it comes."""
    parser = argparse.ArgumentParser(description="effects told apart by designed motions")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 10), metavar=("FROM", "TO"))
    options = parser.parse_args()
    rows = [HEADS]
    for seed in range(*options.seeds):
        for case in options.cases:
            rows.append(row(case, seed))
            print("  ".join(rows[-1]), flush=True)
    print("\n".join(["", shown(rows), "", counts(rows[1:])]))


if __name__ == "__main__":
    main()
