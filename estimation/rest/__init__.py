"""Poses at rest: what they show, and which are missing."""
