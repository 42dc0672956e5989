"""Names of the layouts of logs, for the options of commands and the workbench's form; none is read here."""

from __future__ import annotations

PRESETS = (
    *("ur_rtde", "franka", "ros_csv", "ros_bag", "plotjuggler", "orocos", "kinova"),
    *("xyz_quaternion_wrench", "joints_deg_wrench"),
)
