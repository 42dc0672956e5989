"""Errors in variables: fits that account for noise in the measured motion."""
