# %% [markdown]
# # Which motion to run
#
# **The question: what should the arm do within its limits, so that a short recording tells most?**
#
# How much a recording tells is decided before it is taken, by the motion. This notebook designs motions for the
# chapter's arm, holds them against a bound that no motion can exceed, tries them on a simulated rig, and then designs
# another one for a question: is it a viscous or a quadratic drag?
#
# It needs no robot, but MuJoCo (`pip install "truewrench[simulation]"`), which plays one and shares no equation with
# the models here.

# %%
import numpy as np

import truewrench as tw
from truewrench.simulated_rig import PlanarRig, QuadraticDrag, simulate

rig = tw.Rig.from_data(
    {
        "robot": {"link_lengths": [1.0, 0.97, 0.4], "tip_length": 0.2},  # m; the chapter gives none, these are assumed
        "limits": {
            "position": [1.047, 1.222, 1.396],  # rad
            "velocity": [2.0, 2.2, 3.5],  # rad/s
            "acceleration": [10, 10, 15],  # rad/s²
        },
    }
)

# %% [markdown]
# ## The chapter's series, and the chapter's optimum
#
# Equation 22.10 gives three joints 15 coefficients. The chapter's x_opt came from 115 evaluations without limits; here
# it is scaled until it fits these. The same 15 coefficients, optimised within the limits with exact derivatives, gain
# almost five nats of ln det(Phi' Phi): with the same number of samples each parameter's share of the confidence
# ellipsoid shrinks by exp(gain / 12).

# %%
PERIOD, SAMPLES = 5.0, 200
paper = tw.PaperSeries(joints=3, period=PERIOD)
chapter = paper.chapter_optimum
chapter = chapter.scaled(1 / tw.LimitUse.of(chapter, rig.limits).worst.use)
experiment = tw.Experiment.of(tw.planar(rig), rig.arm)
logdet = {"x_opt of 22.17, scaled": tw.DOptimal().value(experiment.information(chapter, SAMPLES))}

plan = tw.design(rig, series=paper)
logdet["22.10, optimised"] = plan.logdet
plan

# %% [markdown]
# ## How much better could any motion be?
#
# The bound holds for every periodic motion within these limits, whatever its series. Most of what the chapter's series
# leaves is bandwidth: with more harmonics, and with accelerations that switch between their limits, motions come close
# to it. Whether a robot can follow those is for its controller to say, and the reason why they are not the default.

# %%
for name, series in {
    "each joint by itself, 6 harmonics": tw.FreeSeries(joints=3, harmonics=tuple(range(1, 7)), period=PERIOD),
    "steps of acceleration, 50 a period": tw.SplineSeries(joints=3, knots=50, degree=2, period=PERIOD),
}.items():
    better = tw.design(rig, series=series, starts=1, bounded=False)
    logdet[name] = better.logdet
print(f"{'bound on any motion':38} {plan.bound.logdet:.2f} ({plan.bound.kind.value})")
for name, value in logdet.items():
    print(f"{name:38} {value:.2f}   efficiency {plan.bound.efficiency(value):.2f}")

# %%
plan.plot()

# %% [markdown]
# ## Do the estimates get better?
#
# The same tool, the same noise, as many samples: the scatter of the mass over simulated recordings, along the chapter's
# motion and along the designed one, beside what the information promised.

# %%
arm = PlanarRig(noise=(0.15, 0.25, 0.012))
std = np.array(arm.noise)
noise = tw.NoiseModel.white(std)
scatter, promised = {}, {}
for number, (name, motion) in enumerate({"x_opt of 22.17, scaled": chapter, "22.10, optimised": plan.motion}.items()):
    information = tw.Experiment.of(tw.planar(rig), rig.arm, noise=noise).information(motion, SAMPLES)
    promised[name] = float(np.sqrt(np.linalg.inv(information)[3, 3]))
    frame = simulate(arm, motion, repeats=40, samples_per_period=SAMPLES, noise="white", seed=number)
    runs = [run.drop(columns="repeat") for _, run in frame.groupby("repeat")]
    masses = [tw.fit(tw.planar(rig), tw.from_dataframe(run, rig=rig), noise=noise).values["m"] for run in runs]
    scatter[name] = float(np.std(masses, ddof=1))
    print(f"{name:24} std of m: {1e3 * scatter[name]:.2f} g in 40 recordings, {1e3 * promised[name]:.2f} g promised")

# %% [markdown]
# ## A motion for a question
#
# Air drags on the tool; is it with the speed, or with its square? A slow motion cannot say: both explain the recording.
# The motion that separates them best is designed from what that recording knows.

# %%
model, slow = tw.planar(rig), arm.random_motion(seed=3, harmonics=2).scaled(0.35)
DRAG = [QuadraticDrag(c=0.02)]


def recorded(motion, name):
    """Four repeats with the hidden drag."""
    frame = simulate(arm, motion, hidden=DRAG, repeats=4, samples_per_period=SAMPLES, noise="white", seed=5)
    return tw.from_dataframe(frame, rig=rig, name=name)


def chi_square(fit):
    """Sum of the squares of what a fit leaves, over the noise."""
    return float((fit.problem.evaluate(fit.theta)[0] ** 2).sum())


rivals = {"quadratic": model + tw.effects.quadratic_drag(), "viscous": model + tw.effects.viscous_drag()}
ordinary = recorded(slow, "slow.csv")
fits = {name: tw.fit(rival, ordinary) for name, rival in rivals.items()}
before = {name: chi_square(fit) for name, fit in fits.items()}
print("chi-square of the slow recording:", {name: round(value) for name, value in before.items()})

told = tw.discriminate(
    rig,
    rivals["quadratic"],
    fits["quadratic"].values,
    [rivals["viscous"]],
    series=paper,
    samples=SAMPLES,
    noise=noise,
    runs=4,
)
told

# %%
separate = recorded(told.motion, "separate.csv")
after = {name: chi_square(tw.fit(rival, separate)) for name, rival in rivals.items()}
print("chi-square of the designed one:", {name: round(value) for name, value in after.items()})

# %% [markdown]
# ## The answer
#
# The motion with the largest information within the limits, which the bound says cannot be beaten by much; its
# parameters scatter as promised. And where two effects explain a recording alike, a motion designed to tell them apart
# decides by thousands of chi-square what the ordinary one could not.
