"""Calibration: the false-alarm rate and the power that one recording's own motion, rate and noise give."""
