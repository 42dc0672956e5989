"""Surveying: many recordings diagnosed, one row each, on one machine's cores or on a Dask cluster.

The package is not called `survey`, as `truewrench.survey` is the function.
"""

from __future__ import annotations

from truewrench.surveying.survey import Survey, survey

__all__ = ["Survey", "survey"]
