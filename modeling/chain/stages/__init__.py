"""Stages of the measurement chain from the true wrench to the reading, each an object that describes itself."""
