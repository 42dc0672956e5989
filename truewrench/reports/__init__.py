"""HTML report of a diagnosis, self-contained."""

from __future__ import annotations

from truewrench.reports.report_html import report_page, write_report

__all__ = ["report_page", "write_report"]
