"""Tests of `diagnosis.comparison`: what is left of a recording, and which model leaves less."""
