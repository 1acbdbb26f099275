"""A finished study as one self-contained HTML page."""

from strandline.report.html import PANELS, template
from strandline.report.page import FIGURES, add_check, remove_report, write_answer, write_report

__all__ = [
    "FIGURES",
    "PANELS",
    "add_check",
    "remove_report",
    "template",
    "write_answer",
    "write_report",
]
