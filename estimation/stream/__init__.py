"""Fits over any number of parts, in one pass and the memory of a few."""
