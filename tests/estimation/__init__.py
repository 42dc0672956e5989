"""Tests of `estimation`: fits of every kind, at once and in chunks, and their intervals."""
