"""Wording of a study: what its steps, effects, suspects and formulas are in a line of text."""
