"""Search over sets of effects."""
