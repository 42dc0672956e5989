"""Plots of residuals."""
