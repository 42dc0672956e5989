"""Tests of `design.information`: what a motion says of the parameters."""
