"""Fits that a few wild readings do not move."""
