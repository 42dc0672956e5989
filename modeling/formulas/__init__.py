"""Users' formulas: tokens, syntax tree, units, conversion to SymPy; parsed as data, never executed."""
