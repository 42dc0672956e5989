"""Derivatives of a measured motion: smoothing by likelihood, held samples, splines, Fourier series."""
