"""Stages of the chain that remember and are no transfer functions, as operators on series with their derivatives."""
