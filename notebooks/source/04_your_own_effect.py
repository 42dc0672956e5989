# %% [markdown]
# # An effect of one's own
#
# **The question: can the diagnosis find something that its authors have never heard of?**
#
# The catalogue knows what mostly goes wrong on a robot. What goes wrong on *your* robot may be in no catalogue. Then
# the diagnosis says `unexplained`, and where to look; and when you have looked, you can write down what you have seen,
# in a few lines of formulas. Then it is an effect like the others: screened, fitted, and believed only if it holds.
#
# It needs no robot, but MuJoCo (`pip install "truewrench[simulation]"`), which plays one and shares no equation with
# the models here.

# %%
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import truewrench as tw
from truewrench.plots.style import ADEQUATE_COLOUR, INK, LEGEND, MEASURED, MISFIT_COLOUR, PanelGrid
from truewrench.simulated_rig import Magnet, PlanarRig, resolve_effects, simulate

# %% [markdown]
# ## A rig that nobody has written a catalogue for
#
# The arm swings in a vertical plane, past a fixture that holds a magnet. It pulls at the tool with a force that falls
# with the third power of the distance.

# %%
lengths = [1.0, 0.97, 0.4]  # m
rig = tw.Rig.from_data({"robot": {"link_lengths": lengths}, "sensor": {"convention": "on_tool"}})

arm = PlanarRig()
motions = {"train": arm.random_motion(seed=1), "validate": arm.random_motion(seed=2)}
(magnet,) = resolve_effects(arm, motions["train"], [Magnet()])


def record(name, seed):
    """Repeat a motion of 5 s four times, 30 samples to the second, as if it came from a robot."""
    frame = simulate(arm, motions[name], hidden=[magnet], repeats=4, samples_per_period=150, seed=seed)
    return tw.from_dataframe(frame, rig=rig, name=name)


train, validate = record("train", 0), record("validate", 1)

# %% [markdown]
# ## Unexplained
#
# This arm has been calibrated and its sensor is new: what is missing acts on the tool, and to be quick only effects
# that do are tried here. (With the whole catalogue it takes a minute, and ends the same way.)

# %%
model = tw.planar(rig)
on_the_tool = [effect for effect in tw.effects.catalogue(model.space) if effect.stage.name == "TIP_BODY"]
unknown = tw.diagnose(model, train, validate=validate, effects=on_the_tool)
unknown

# %% [markdown]
# Nothing of it explains what is left. The last line says where that is, and the residual can say more. Averaged over
# the repeats it is the wrench on the tool that the model does not know of. Its torque is the force across the tip times
# how far along the tip the force acts, d; and with that it can be drawn, where the tool was at the time.


# %%
def unknown_force(comparison):
    """The force on the tool (N) that the model lacks and the path (m) of where it acts, in the world, of one repeat."""
    recording = comparison.recording
    once = slice(recording.samples_per_repeat)
    phi, px, py = (recording.signals[name][once] for name in ("phi", "px", "py"))
    across, along, torque = -recording.averaged(comparison.residual)[once].T  # the sensor's on the tool, turned round
    d = torque @ across / (across @ across)
    x_axis, tip = np.array([np.cos(phi), -np.sin(phi)]), np.array([np.sin(phi), np.cos(phi)])
    return np.array([px, py]) + d * tip, across * x_axis - along * tip  # the second channel is along -y'


def force_figure(path, force, marks):
    """The strong forces as arrows along the path, 15 N as long as 1 m, and points by name."""
    figure, panels = PanelGrid(rows=1, columns=1, panel_height=300, width=640).panels()
    axes = panels[0, 0]
    axes.plot(*path, color=MEASURED, lw=0.8)
    strong = np.hypot(*force) > 1.0
    axes.quiver(
        *path[:, strong], *force[:, strong], color=MISFIT_COLOUR, angles="xy", scale_units="xy", scale=15, width=0.003
    )
    for name, (x, y), marker, colour in marks:
        axes.plot(x, y, marker, ms=9, mec=colour, mfc="none", mew=1.6, ls="none", label=name)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(1.4, 2.3), ylim=(1.45, 1.85))
    if marks:
        axes.legend(loc="upper left", **LEGEND)
    return figure


path, force = unknown_force(unknown.steps[-1].training[0])
force_figure(path, force, [])

# %% [markdown]
# The arrows cross at a place to the right of the path, and are strong near it only. Somebody goes there with a
# screwdriver, and feels the magnet.
#
# ## Six lines
#
# A file of effects says what pulls, in formulas over named signals. `tip_x` and `tip_y` are where the point `at` on the
# tip is; the strength is estimated and tested, the rest is searched: the place to the right of the path, the pole
# somewhere along the tip. Units are checked, so that a forgotten power is an error message and no discovery. A file is
# data: its formulas are parsed, and nothing in it can run.

# %%
text = """
[[effect]]
id = "magnet"
title = "magnet beside the fixture"
parameters = { strength = "N m^3", x = { unit = "m", bounds = [1.5, 2.5], search = 9 }, y = { unit = "m", bounds = [1, 2], search = 9 }, d = { unit = "m", bounds = [0, 0.3], search = 4 } }
let = { ux = "x - tip_x", uy = "y - tip_y", r = "sqrt(ux^2 + uy^2)" }
tip_body = { at = "d", force_x = "strength*ux/r^4", force_y = "strength*uy/r^4" }
"""  # noqa: E501
scratch = TemporaryDirectory()
folder = Path(scratch.name)
(folder / "effects.toml").write_text(text)
(own,) = tw.read_effects(folder / "effects.toml")
print(own.equation)

# %% [markdown]
# What is no such formula is refused, with its place in the text.

# %%
slips = {"r^4": "r^3", "ux/r^4": "ux.real", "tip_x": "tipx"}
for right, wrong in slips.items():
    (folder / "slip.toml").write_text(text.replace(right, wrong))
    try:
        tw.read_effects(folder / "slip.toml")
    except tw.InputError as error:
        print(str(error).removeprefix(f"{folder}/"), end="\n\n")
scratch.cleanup()

# %% [markdown]
# ## Found
#
# The diagnosis takes it as one candidate among the others, which it has to beat, with its search paid for.

# %%
found = tw.diagnose(model, train, validate=validate, effects=[*on_the_tool, own])
found

# %% [markdown]
# The error is down in the noise, also on the other motion. And it is the magnet that was hidden:

# %%
x, _, y = magnet.place
hidden = {"strength": magnet.strength, "x": x, "y": y, "d": magnet.d}
estimates = {name: found.fit.parameters[f"magnet.{name}"] for name in hidden}
for name, true in hidden.items():
    estimate = estimates[name]
    print(f"{name:9} hidden {true:7.4f}   found {estimate.value:7.4f} ± {estimate.std:.4f} {estimate.unit}")

# %%
marks = [
    ("hidden", (x, y), "s", INK),
    ("found", [estimates[axis].value for axis in "xy"], "x", ADEQUATE_COLOUR),
]
force_figure(path, force, marks)


# %% [markdown]
# The maps of the torque, before and after:

# %%
found.plot(kind="map", channel="tau")

# %% [markdown]
# ## The answer
#
# Yes: `unexplained` was right as long as the catalogue had no magnet, and six lines of formulas were enough for it to
# be named, with its place and its strength, against every other effect.
#
# With recordings of your own:
#
# ```sh
# truewrench diagnose train.csv --rig rig.toml --validate validate.csv --effects effects.toml --out report
# truewrench fit train.csv --rig rig.toml --effects effects.toml --add magnet --out model.json
# ```
#
# The model file holds the formulas, so that `compensate` and `design` need nothing else. In Python the same effect is
# `tw.own_effect(id=..., title=..., parameters=..., tip_body=...)`, its formulas as text or as SymPy expressions.
