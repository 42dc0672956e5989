"""Tests of `modeling.compiled`: expressions as programs, their derivatives and their store."""
