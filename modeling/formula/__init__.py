"""Formulas: text of arithmetic, named quantities and a list of functions, read as data and never executed."""
