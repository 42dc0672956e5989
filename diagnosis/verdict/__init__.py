"""Verdicts, upper limits, aliases, result.json."""
