"""Stationary noise of the readings: autoregressive or by its spectrum, and the maps that whiten it."""
