"""Deflection of a tool on a spring: equation of motion, its solution over a record and from sample to sample."""
