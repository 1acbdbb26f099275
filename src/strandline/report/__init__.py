"""A finished study as one self-contained HTML page."""

from strandline.report.page import write_report

__all__ = ["write_report"]
