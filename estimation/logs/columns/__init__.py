"""Columns of a log: which is which, in what unit and orientation form."""
