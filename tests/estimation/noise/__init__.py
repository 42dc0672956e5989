"""Tests of `estimation.noise`: spectra, whitening, tones and events."""
