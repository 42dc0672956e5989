"""Clocks of logs: samples mended, offsets estimated, everything on one clock."""
