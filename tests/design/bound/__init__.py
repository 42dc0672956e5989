"""Tests of `design.bound`: what no motion can exceed."""
