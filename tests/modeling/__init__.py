"""Tests of `modeling`: the rig, the table, the printed equations, and what a motion does not show."""
