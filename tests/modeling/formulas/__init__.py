"""Tests of `modeling.formulas`: effects of one's own, as text."""
