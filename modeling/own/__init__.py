"""Effects of one's own: a definition of names, units and formulas, and the effect of the chain that it makes."""
