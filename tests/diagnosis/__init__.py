"""Tests of `diagnosis`: what is found, judged and accepted, in simulated and measured recordings."""
