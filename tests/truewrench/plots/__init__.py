"""Tests of `truewrench.plots`: figures that are true and whole."""
