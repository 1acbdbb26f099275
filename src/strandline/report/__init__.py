"""A finished study as one self-contained HTML page."""

from strandline.report.page import add_check, write_report

__all__ = ["add_check", "write_report"]
