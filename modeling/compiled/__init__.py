"""Derived expressions compiled: straight-line programs, their evaluation over samples, and their derivatives."""
