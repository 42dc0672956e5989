"""Effects defined by users as formulas with units."""
