"""Residual against noise: reduced chi-square, systematic error, residual maps, validation."""
