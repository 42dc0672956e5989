"""Optimisers that a user would take instead of ours, on one problem, each with a trace of what it found by when."""
