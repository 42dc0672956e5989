"""Tests of `modeling.codegen`: emitted code, and the tool as robots take it."""
