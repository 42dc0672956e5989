"""Figures (matplotlib, without pyplot)."""
