"""Robust estimation: M-estimates with Huber's or Student's loss, and outlier detection in coloured noise."""
