# %% [markdown]
# # A first diagnosis, in five minutes
#
# **The question: the model of the tool misses what the sensor reads. What is missing in it?**
#
# A force/torque sensor at a robot's wrist reads what it takes to carry the tool. A rigid tool is soon modelled: a zero
# for each channel, a mass, where it is, how hard it is to turn. When that model misses what the sensor reads by more
# than the sensor's noise, something on the rig is not in the model.
#
# It needs no robot, but MuJoCo (`pip install "truewrench[simulation]"`), which plays one and shares no equation with
# the models here.

# %%
import truewrench as tw
from truewrench.simulated_rig import HIDDEN_EFFECTS, PlanarRig, resolve_effects, simulate

# %% [markdown]
# ## A rig that hides something
#
# An arm of three joints swings in a vertical plane. A tether is tied to its tool, slack during half of the motion,
# and the rig's description has no word of it: it states the links, and the sign in which the sensor reads. With a rig
# file and recordings of your own, `tw.Rig.read("rig.toml")` and `tw.read("train.csv", rig=rig)` stand here instead.

# %%
lengths = [1.0, 0.97, 0.4]  # m
rig = tw.Rig.from_data({"robot": {"link_lengths": lengths}, "sensor": {"convention": "on_tool"}})

arm = PlanarRig()
motions = {"train": arm.random_motion(seed=1), "validate": arm.random_motion(seed=2)}
(tether,) = resolve_effects(arm, motions["train"], [HIDDEN_EFFECTS["cable_spring"]])


def record(name, motion, hidden):
    """Repeat a motion of 5 s six times, 50 samples to the second."""
    seed = list(motions).index(motion)
    frame = simulate(arm, motions[motion], hidden=[hidden], repeats=6, samples_per_period=250, seed=seed)
    return tw.from_dataframe(frame, rig=rig, name=name)


train = record("train", "train", tether)
validate = record("validate", "validate", tether)

# %% [markdown]
# The motion repeats because noise does not. What differs from one repeat to the next is noise, and gives the floor;
# what comes back in every repeat is physics, and can be explained.
#
# ## Where does the rigid tool fail?

# %%
study = tw.study(rig, train, validate=validate)
where = study.where()
where

# %% [markdown]
# The *systematic* RMS says that something is missing. It is the part of the error that comes back in every repeat: it
# would be near zero if the model were right, whatever the noise. A map says where: each panel sets the residual of one
# channel against something that might cause it; orange cells stand out, bars are intervals of 95 % over the repeats.

# %%
study.plot(kind="map", channel="fy")

# %% [markdown]
# ## What may be missing?
#
# Every effect of the catalogue is tried on what is left. Most are significant: each follows a little of what is left,
# as anything does that moves with the arm. So the p-value decides little, and the share of the error that an effect
# would remove says more.

# %%
suspects = study.suspects()
suspects.plot()

# %% [markdown]
# ## Let it be found
#
# `diagnose` refits the promising ones exactly, together with everything else. An effect stays only if it also lowers
# the error on the second motion, which nothing was fitted to.

# %%
rigid = study.fit
found = study.diagnose()
found

# %%
study.plot()

# %% [markdown]
# One effect, and nothing left. The rigid tool's parameters had bent themselves to take in some of the tether; their
# standard deviations looked reassuring and meant nothing, because they count the noise alone. The tool's true inertia
# is 0.0129 kg m².

# %%
tethered = study.fit
for name, fitted in {"rigid tool": rigid, "with the tether": tethered}.items():
    print(f"{name:16} I = {fitted['I'].value:.4f} ± {fitted['I'].std:.4f} kg m²")

# %% [markdown]
# The tether has a stiffness, a place on the tool and an anchor. Set against what was hidden, the anchor's height is
# known to the centimetre, its distance far less well: from where the arm moves, a longer tether tied farther away pulls
# nearly alike. The standard deviations say so.

# %%
x, _, y = tether.anchor
hidden = {"k": tether.k, "anchor_x": x, "anchor_y": y, "length": tether.length, "d": tether.d}
for name, true in hidden.items():
    estimate = tethered.parameters[f"cable_spring.{name}"]
    print(f"{name:9} hidden {true:6.3f}   found {estimate.value:6.3f} ± {estimate.std:.3f} {estimate.unit}")

# %% [markdown]
# ## When nobody knows
#
# Now a magnet stands beside the path, and the catalogue has no magnets.

# %%
(magnet,) = resolve_effects(arm, motions["train"], [HIDDEN_EFFECTS["magnet"]])
pulled, pulled_again = (record(f"magnet_{motion}", motion, magnet) for motion in motions)
unknown = tw.diagnose(tw.planar(rig), pulled, validate=pulled_again)
unknown

# %% [markdown]
# `unexplained` is the right answer: refitted, the candidates do not explain it, or do not hold on the second motion,
# or leave more than half. So none of them gets the blame. The last line says in which channel the rest is loudest and
# where to look, and the maps draw it: the torque is pulled aside at the end of the path, low and to the right.

# %%
print("the magnet is at x = {:.2f} m, y = {:.2f} m".format(*magnet.place[::2]))
unknown.plot(kind="map", channel="tau")

# %% [markdown]
# ## The answer
#
# A tether was missing: `explained`, by one effect out of 24, and the error of both recordings is down in the noise.
# The magnet is in no catalogue, and so the answer is `unexplained`, with the place to look; how to write it down as an
# effect of one's own is in `04_your_own_effect`. With recordings of your own, all of this is one command, and a
# report:
#
# ```sh
# truewrench diagnose train.csv --rig rig.toml --validate validate.csv --out report
# ```
