"""Tests of `modeling.dynamics`: what has memory."""
