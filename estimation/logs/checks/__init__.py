"""Checks of what was read: which columns could be either of two things, and what the readings show against them."""
