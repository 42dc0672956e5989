"""Fits of models whose signals of motion are themselves measured with noise."""
