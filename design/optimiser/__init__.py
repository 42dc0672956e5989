"""Optimiser: the best motion of a series within its limits, by an interior point with exact derivatives."""
