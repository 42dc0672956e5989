"""Tests of `estimation.readings`: what may be mistaken in a log."""
