"""Tests of `design`: criteria, limits, motions and the search for them."""
