"""Repeatability: systematic and random errors over the repeats of a motion, and the bootstrap of estimates."""
