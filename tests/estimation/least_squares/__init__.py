"""Tests of `estimation.least_squares`: minimisation, with and without constraints."""
