# %% [markdown]
# # Find it yourself
#
# **The question: this recording hides one effect. Which?**
#
# Stop after each table and picture and make up your mind, before the next cell gives it away. It needs no robot, but
# MuJoCo (`pip install "truewrench[simulation]"`), which plays one and shares no equation with the models here.

# %%
import numpy as np

import truewrench as tw
from truewrench.simulated_rig import HIDDEN_EFFECTS, PlanarRig, simulate

# %% [markdown]
# ## The puzzle
#
# One of four effects is drawn, and nothing prints which. Change `PUZZLE` for another one. The motion is repeated six
# times, so that noise can be told from physics; a second motion is held out.

# %%
PUZZLE = 2
DRAWN = ("sensor_lag", "coulomb_friction", "viscous_drag", "com_offset")
secret = DRAWN[np.random.default_rng(PUZZLE).integers(len(DRAWN))]

lengths = [1.0, 0.97, 0.4]  # m
rig = tw.Rig.from_data({"robot": {"link_lengths": lengths}, "sensor": {"convention": "on_tool"}})
arm = PlanarRig()


def record(name, seed):
    """A random motion of 5 s, six times, 50 samples to the second, with the secret in it."""
    motion = arm.random_motion(seed=seed)
    frame = simulate(arm, motion, hidden=[HIDDEN_EFFECTS[secret]], repeats=6, samples_per_period=250, seed=seed)
    return tw.from_dataframe(frame, rig=rig, name=name)


study = tw.study(rig, record("train", 11), validate=record("validate", 12))

# %% [markdown]
# ## By hand
#
# First look: is there anything to find, in which channel, and against what?

# %%
study.where()

# %%
study.plot(kind="map")

# %% [markdown]
# Form a suspicion. What follows the speed of the tool may be a drag, or a friction. What follows a load or an
# acceleration may be a mass that is not where the model has it; or a reading that comes late, which shows as the rate
# of change of the load. The list has all of them, with the share of the error that each would remove:

# %%
suspects = study.suspects()
suspects

# %% [markdown]
# A wrong suspicion is worth a try too: it teaches how a wrong one looks. Coulomb friction is of constant size and
# turns with the direction of motion.

# %%
wrong = study.add("coulomb_friction")
study.stairs()

# %% [markdown]
# Fitted as well as it can be, it leaves the error where it was, and the lack-of-fit p-value says so, on both
# recordings. Take it away again, and take the head of the list.

# %%
study.undo()
suspicion = suspects.to_frame().iloc[0]["effect"]
right = study.add(suspicion)
study.stairs()

# %%
study.plot(kind="residual")

# %% [markdown]
# Is that difference on the held-out recording significant, or luck?

# %%
study.compare(0, 1)

# %% [markdown]
# And what else? With the right effect in the model nothing stands out any more.

# %%
rest = study.where()
rest

# %% [markdown]
# ## Let it be found
#
# The same from the start, without a hand: every candidate is tried, refitted, and held against the second recording.

# %%
found = tw.diagnose(tw.planar(rig), study.fit.recordings, validate=[c.recording for c in right.validation])
found

# %% [markdown]
# ## The answer

# %%
print(f"hidden: {secret}; by hand: {suspicion}; found: {', '.join(found.added)}")
