"""Survey: diagnosis of many recordings, one row each, on local cores or on a Dask cluster.

The package is not called `survey` because `truewrench.survey` is the function.
"""

from __future__ import annotations

from truewrench.surveying.survey import Survey, survey

__all__ = ["Survey", "survey"]
