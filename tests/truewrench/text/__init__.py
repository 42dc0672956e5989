"""Tests of `truewrench.text`: sentences about tools and verdicts."""
