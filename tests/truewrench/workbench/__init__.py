"""Tests of the workbench: its parts, and the page in a real browser."""
