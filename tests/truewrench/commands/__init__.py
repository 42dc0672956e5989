"""Tests of single commands: words, files, JSON and exit codes."""
