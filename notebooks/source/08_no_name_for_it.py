# %% [markdown]
# # No name for it
#
# **The question: nobody knows what is missing. Can the recordings say its equation?**
#
# [An effect of one's own](04_your_own_effect.ipynb) asks for somebody who looks, and has an idea. Here nobody has
# one: no effect of the catalogue explains what is left, and an equation is looked for among all that can be built of
# the motion of the tool. One is believed only if it holds on a second motion, with its constants as they came out of
# the first.
#
# It needs no robot, but MuJoCo (`pip install "truewrench[simulation]"`), which plays one and shares no equation with
# the models here.

# %%
from pathlib import Path
from tempfile import TemporaryDirectory

import truewrench as tw
from truewrench.simulated_rig import MagnusForce, PlanarRig, simulate

# %% [markdown]
# ## Three motions of a rig
#
# The tool is a smooth ball that turns while it flies: the air pushes it across its way, `force = c (spin x
# velocity)`, as it does a football. No robot's manual has it.

# %%
rig = tw.Rig.from_data({"robot": {"link_lengths": [1.0, 0.97, 0.4]}, "sensor": {"convention": "on_tool"}})
spin = MagnusForce(c=0.06, d=0.12)  # kg, m along the tip
arm, hidden = PlanarRig(), [spin]


def record(seed):
    """Repeat a motion of 5 s four times, 40 samples to the second, as if it came from a robot."""
    frame = simulate(arm, arm.random_motion(seed=seed), hidden=hidden, repeats=4, samples_per_period=200, seed=seed)
    return tw.from_dataframe(frame.drop(columns="temperature"), rig=rig, name=f"motion {seed}")


first, second, third = (record(seed) for seed in (1, 2, 3))

# %% [markdown]
# The rigid tool does not fit, and of what acts on a tool and is in the catalogue nothing helps.

# %%
model = tw.planar(rig)
on_the_tool = [effect for effect in tw.effects.catalogue(model.space) if effect.stage.name == "TIP_BODY"]
unknown = tw.diagnose(model, first, validate=second, effects=on_the_tool)
print(str(unknown).splitlines()[0])

# %% [markdown]
# ## An equation
#
# All terms up to a complexity are tested beside the model: forces at the sensor or at a point of the tip, torques,
# zeros of the channels; of velocities, accelerations, angular rates, directions, positions, their products and
# powers. What is significant has survived the number of them. Then the second motion is asked.

# %%
found = tw.discover(model, first, validate=second, complexity=4)
found

# %% [markdown]
# `v x w` at the distance `d` along the tip is the force across the way of that point, in proportion to how fast the
# tool turns; minus it is `w x v`, which is what was hidden, with its size and its place:

# %%
equation = found.equations[0]
for name, true in {"c": -spin.c, "d": spin.d}.items():
    value, std, unit = equation.parameters[name]
    print(f"{name}   hidden {true:8.4f}   found {value:8.4f} ± {std:.4f} {unit}")

# %% [markdown]
# ## Added
#
# What comes out is an effect like any other, in a file: formulas that are parsed, with units that are checked.

# %%
scratch = TemporaryDirectory()
path = Path(scratch.name) / "found.toml"
path.write_text(found.effects_toml)
(effect,) = tw.read_effects(path)
print(found.effects_toml)
scratch.cleanup()

# %% [markdown]
# On a third motion, of which nothing has been used, the error falls to the noise:

# %%
before, after = tw.fit(model, first), tw.fit(model + effect, first, start=dict(found.last.values))
compared = tw.compare({"rigid tool": before, "with the equation": after}, third)
compared

# %%
after_third = tw.compare(after, third)
after_third.plot()

# %% [markdown]
# ## And where there is none
#
# The same search where nothing is hidden:

# %%
quiet = [
    tw.from_dataframe(
        simulate(arm, arm.random_motion(seed=seed), repeats=4, samples_per_period=200, seed=seed).drop(
            columns="temperature"
        ),
        rig=rig,
        name=f"quiet {seed}",
    )
    for seed in (4, 5)
]
nothing = tw.discover(model, quiet[0], validate=quiet[1], complexity=4)
nothing

# %% [markdown]
# ## The answer
#
# Yes, where the equation is short, and made of what the motion shows: then it comes out with its constants, and holds
# where it was not fitted. Where it does not, or where there is nothing, no equation is said.
#
# With recordings of your own:
#
# ```sh
# truewrench discover train.csv --rig rig.toml --validate validate.csv --out found.toml
# truewrench fit train.csv --rig rig.toml --effects found.toml --add found_1 --out model.json
# ```
