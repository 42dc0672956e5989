"""Numerical evaluation of derived expressions and of their parameter derivatives over arrays of samples."""
