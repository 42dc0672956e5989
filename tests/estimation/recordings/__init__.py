"""Tests of `estimation.recordings`: signals, derivatives, periods and repeats."""
