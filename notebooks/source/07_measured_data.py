# %% [markdown]
# # A measured recording
#
# **The question: what does a real sensor's log say about its tool, and what does it not say?**
#
# A KUKA LBR Med 14 carried an unknown tool on an ATI Gamma force/torque sensor: 24 poses at rest, and runs of 6 s. The
# recordings are public: A. Skrede, "Accelerometer and Force/Torque Sensor Measurements for Parameter and State
# Estimation of an Unknown Robot End Effector", Zenodo 11096791, CC BY 4.0; here with their time bases merged, as CSV.
# Their folder `ais2202` is looked for where `TRUEWRENCH_DATA` says, else in `shared/data` beside this repository.

# %%
import os
from pathlib import Path

import truewrench as tw

beside = [folder / "shared" / "data" for folder in Path.cwd().parents]
places = [Path(os.environ["TRUEWRENCH_DATA"])] if "TRUEWRENCH_DATA" in os.environ else beside
data = next((place / "ais2202" for place in places if (place / "ais2202").is_dir()), None)
if data is None:
    raise SystemExit("no folder ais2202: set TRUEWRENCH_DATA to the folder that holds it")
rig = tw.Rig.read(data / "rig.toml")

# %% [markdown]
# ## The tool's weight, from poses at rest
#
# At rest the sensor reads the weight of the tool, turned with the pose, and its own zero. That gives the mass and its
# centre. Inertia it cannot give, and the fit says so instead of printing a number.

# %%
poses = tw.read(data / "calibration_poses.csv", rig=rig)
static = tw.fit(tw.spatial(rig), poses)
static

# %%
centre = tw.CentreOfMass.of(static)
centre

# %% [markdown]
# Does the rigid tool explain the poses? Without repeats the noise is taken from the residual itself, so that only the
# pattern of the residual can speak, here over the directions of gravity.

# %%
misfit = tw.compare(static, poses)
misfit

# %% [markdown]
# The residual of fx is nearly three times that of fy, and in such a sensor the noise of the two is alike: what is left
# in fx is not all noise. A force that depends on the pose, of a cable for instance, would look like this; 24 poses
# without repeats do not prove it.
#
# ## A run
#
# In the runs the wrist turns half a turn about one axis, in 6 s. Gravity stays in a plane, and the motion is slow.

# %%
baseline = tw.read(data / "baseline.csv", rig=rig)
moving = tw.fit(tw.spatial(rig), baseline)
moving.params[["value", "std", "unit"]]

# %% [markdown]
# Look at the standard deviations before the values: what this motion does not excite, it does not determine.

# %%
moving.plot(kind="spectrum")

# %% [markdown]
# The spectrum has lines: vibrations of the robot, much stronger than the sensor's noise, and nothing that an effect of
# the tool could be made responsible for.
#
# ## Touched by hand
#
# In a third run somebody touches the tool. The model of the poses and their zero is subtracted, and the rest is
# contact.

# %%
touched = tw.read(data / "contact.csv", rig=rig)
contact = tw.compensate(static, touched)
contact

# %%
contact.plot()

# %% [markdown]
# ## The answer

# %%
mass = static["m"]
print(f"mass of the tool, from the poses: {mass.value:.3f} ± {mass.std:.3f} kg")
print(f"mass of the tool, from the run alone: {moving['m'].value:.3f} ± {moving['m'].std:.3f} kg")
print(f"contacts found in the third run: {len(contact.intervals)}")

# %% [markdown]
# The two masses agree within two of their standard deviations, and that of the run is ten times as large: its motion
# does not tell the weight from the zero and the vibrations well enough, and the poses are the ones to believe.
# Nobody has published the true mass. The inertia is in none of these recordings: they are too slow.
