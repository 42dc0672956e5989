"""Tests of `estimation.contact`: contact wrenches, points and detection."""
