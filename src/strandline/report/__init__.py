"""A finished study as one self-contained HTML page."""

from strandline.report.page import add_check, template, write_report

__all__ = ["add_check", "template", "write_report"]
