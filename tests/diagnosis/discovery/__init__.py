"""Tests of `diagnosis.discovery`: terms of the grammar, and what is found with them."""
