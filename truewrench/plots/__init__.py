"""Figures of a diagnosis: each module draws one, as a matplotlib Figure, never through pyplot."""
