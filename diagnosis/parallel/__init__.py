"""Process pool in SPMD style, and progress."""
