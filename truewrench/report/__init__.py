"""Report: a diagnosis as one page that shows where the model fails before it says so, and needs no network."""

from __future__ import annotations

from truewrench.report.page import report_page, write_report

__all__ = ["report_page", "write_report"]
