"""Tests of `truewrench`: commands, results, files, reports, surveys and the simulated rig."""
