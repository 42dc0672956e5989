"""Tests of `diagnosis.screening`: score tests."""
