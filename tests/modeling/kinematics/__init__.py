"""Tests of `modeling.kinematics`: planar and spatial arms."""
