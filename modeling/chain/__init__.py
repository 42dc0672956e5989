"""Measurement chain from motion to reading: stages, effects, wrench model, prediction, regressor."""
