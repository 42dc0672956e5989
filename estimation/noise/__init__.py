"""Noise of recordings: spectra, autoregression, whitening, leakage and recording-specific disturbances."""
