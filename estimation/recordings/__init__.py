"""Recordings: reading and validation, sample clock, derivatives of the motion, sign convention."""
