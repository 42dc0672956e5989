"""Exciting motions within the limits: criteria, their optimum and its bound."""
