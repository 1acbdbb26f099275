"""A finished study as one self-contained HTML page."""

from strandline.report.html import PANELS, template
from strandline.report.page import ANSWERS, FIGURES, add_check, remove_report, write_answer, write_report

__all__ = ["ANSWERS", "FIGURES", "PANELS", "add_check", "remove_report", "template", "write_answer", "write_report"]
