"""Emission: models as source code and formulas that leave the project."""
