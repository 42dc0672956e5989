"""Least squares: square-root information, Levenberg-Marquardt, identifiability and constraints."""
