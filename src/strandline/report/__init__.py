"""A finished study as one self-contained HTML page."""

from strandline.report.inline import PANELS
from strandline.report.page import (
    FIGURES,
    add_check,
    remove_report,
    template,
    write_comparison,
    write_coverage,
    write_next,
    write_report,
    write_specimens,
    write_what_if,
)

__all__ = [
    "FIGURES",
    "PANELS",
    "add_check",
    "remove_report",
    "template",
    "write_comparison",
    "write_coverage",
    "write_next",
    "write_report",
    "write_specimens",
    "write_what_if",
]
