"""Tests of the physics, the estimates, the designs and the verdicts."""
