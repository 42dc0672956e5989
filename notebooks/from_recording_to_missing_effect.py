# %% [markdown]
# # From a recording to the missing effect
#
# A force/torque sensor at a robot's wrist reads what it takes to carry the tool. A rigid tool is soon modelled: a zero
# for each channel, a mass, where it is, how hard it is to turn. When that model misses what the sensor reads by more
# than the sensor's noise, something on the rig is not in the model. This notebook finds out what.
#
# It needs no robot, but MuJoCo (`pip install "truewrench[simulation]"`), which plays one and shares no equation with
# the models here. Open it as a notebook (VS Code, or Jupyter with jupytext), or run it as a script.

# %%
# %matplotlib inline
from pathlib import Path

import truewrench as tw
from diagnosis.comparison.residual_map import residual_maps
from truewrench.plots.residuals.residual_map_plot import residual_map_figure
from truewrench.simulated_rig import HIDDEN_EFFECTS, PlanarRig, resolve_effects, simulate, write_recording

# %% [markdown]
# ## A rig that hides something
#
# An arm of three joints swings in a vertical plane. A tether is tied to its tool, slack during half of the motion,
# and the rig's description has no word of it: it states the links, and the sign in which the sensor reads.

# %%
folder = Path("demo_report", "notebook")
folder.mkdir(parents=True, exist_ok=True)
(folder / "rig.toml").write_text("""
[robot]
link_lengths = [1.0, 0.97, 0.4]   # m

[sensor]
convention = "on_tool"
""")
rig = tw.Rig.read(folder / "rig.toml")

arm = PlanarRig()
motions = {"train": arm.random_motion(seed=1), "validate": arm.random_motion(seed=2)}
(tether,) = resolve_effects(arm, motions["train"], [HIDDEN_EFFECTS["cable_spring"]])


def record(name, motion, hidden):
    """Repeat a motion of 5 s six times, 50 samples to the second, and read the file as if it came from a robot."""
    seed = list(motions).index(motion)
    frame = simulate(arm, motions[motion], hidden=[hidden], repeats=6, samples_per_period=250, seed=seed)
    return tw.read(write_recording(frame, folder / f"{name}.csv"), rig=rig)


train = record("train", "train", tether)
validate = record("validate", "validate", tether)

# %% [markdown]
# The motion repeats because noise does not. What differs from one repeat to the next is noise, and gives the floor;
# what comes back in every repeat is physics, and can be explained.
#
# ## Fit and compare

# %%
model = tw.planar(rig)
rigid = tw.fit(model, train)
misfit = tw.compare(rigid, train)
print(rigid, misfit, sep="\n\n")

# %% [markdown]
# The standard deviations look reassuring and mean nothing here: they count the noise alone, while the parameters have
# bent themselves to take in some of the tether. The tool's true inertia is 0.0129 kg m².
#
# The *explainable* RMS says that something is missing. It is the part of the error that comes back in every repeat: it
# would be near zero if the model were right, whatever the noise. A map says where. Each panel sets the residual of one
# channel against something that might cause it; orange cells stand out, bars are intervals of 95 % over the repeats.


# %%
def maps_of(comparison, channel):
    """Maps of a channel by variable, the telling ones first; less than a tenth of the noise floor is of no interest."""
    tolerance = {name: floor / 10 for name, floor in comparison.noise_floor.items()}
    return {m.variable: m for m in residual_maps(comparison, tolerance) if m.channel == channel}


before = maps_of(misfit, "fy")
telling = list(before)[:4]
residual_map_figure([("rigid tool", [before[name] for name in telling])])

# %% [markdown]
# ## Diagnose
#
# Every effect of the catalogue is tried on what is left, and the promising ones are refitted exactly together with
# everything else. An effect stays only if it also lowers the error on the second motion, which nothing was fitted to.

# %%
found = tw.diagnose(model, train, validate=validate)
print(found)

# %% [markdown]
# One effect, and nothing left. Of the others most are `negligible`, which is more than not found: even the largest
# amount that these recordings allow would not matter.
#
# ## Model + effect
#
# A model plus an effect is a model again. It is fitted and compared like the first; on the second motion, only the
# zero of each channel is estimated anew.

# %%
better = model + tw.effects.cable_spring()
tethered = tw.fit(better, train)
print(tethered)
print(tw.compare(rigid, validate), tw.compare(tethered, validate), sep="\n\n")

# %% [markdown]
# The inertia is right again, and the tether has a stiffness, a place on the tool and an anchor. Set against what was
# hidden, the anchor's height is known to the centimetre, its distance far less well: from where the arm moves, a longer
# tether tied farther away pulls nearly alike. The standard deviations say so.

# %%
x, _, y = tether.anchor
hidden = {"k": tether.k, "anchor_x": x, "anchor_y": y, "length": tether.length, "d": tether.d}
for name, true in hidden.items():
    estimate = tethered.parameters[f"cable_spring.{name}"]
    print(f"{name:9} hidden {true:6.3f}   found {estimate.value:6.3f} ± {estimate.std:.3f} {estimate.unit}")

# %% [markdown]
# The same maps, before and after. (With so many cells, one may still be orange by chance.)

# %%
after = maps_of(tw.compare(tethered, train), "fy")
residual_map_figure(
    [(label, [maps[name] for name in telling]) for label, maps in (("rigid tool", before), ("tether", after))]
)

# %% [markdown]
# ## When nobody knows
#
# Now a magnet stands beside the path, and the catalogue has no magnets.

# %%
(magnet,) = resolve_effects(arm, motions["train"], [HIDDEN_EFFECTS["magnet"]])
pulled, pulled_again = (record(f"magnet_{motion}", motion, magnet) for motion in motions)
unknown = tw.diagnose(model, pulled, validate=pulled_again)
print(unknown)

# %% [markdown]
# `unexplained` is the right answer. Several effects are significant, with p-values that would be celebrated elsewhere:
# each follows a little of what is left, as anything does that moves with the arm. But refitted, they do not explain it,
# or do not hold on the second motion, or leave more than half. So none of them gets the blame.
#
# The last line says in which channel the rest is loudest and where to look, and the maps draw it: the torque is pulled
# aside at the end of the path, low and to the right. Go there with a screwdriver, and feel it.

# %%
left = maps_of(unknown.steps[-1].training[0], "tau")
print("the magnet hangs at x = {:.2f} m, y = {:.2f} m".format(*magnet.place[::2]))
residual_map_figure([("rigid tool", list(left.values())[:4])])

# %% [markdown]
# With recordings of your own, all of this is one command, and a report:
#
# ```sh
# truewrench diagnose train.csv --rig rig.toml --validate validate.csv --out report
# ```
