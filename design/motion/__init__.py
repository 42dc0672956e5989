"""Families of joint motions, linear in their coefficients, and rigorous bounds on them between samples."""
