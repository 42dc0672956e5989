"""Estimation: recordings, noise, least-squares fits under constraints, repeatability and contact."""
