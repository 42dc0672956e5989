"""Checks on held-out data."""
