"""Workbench: the loop by hand in a web page on this machine, for who has a log file and no wish to write code."""
