"""Static poses: the parameters identifiable from them, and the design of further poses."""
