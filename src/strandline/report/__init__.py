"""A finished study as one self-contained HTML page.

In: results, handed over by `studies` and `questions`. Out: `report.html`, figures, the warnings about a posterior, the
panels of the live page.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.report.explore import DRAWS, by_name, rounded
    from strandline.report.fields import fields_as_json, without_coefficients
    from strandline.report.fit import as_json, fit_as_json, nearest_runs, nothing_near
    from strandline.report.html import PANELS, said, save_page, small_share, template
    from strandline.report.page import FIGURES, add_check, click_page, remove_report, write_answer, write_report
    from strandline.report.plots import plot_conditions, plot_flow, plot_interfaces
    from strandline.report.plots.answers import axis_label
    from strandline.report.plots.pairs import PosteriorPlots
    from strandline.report.plots.picture import plot_picture, plot_stack
    from strandline.report.plots.style import DOTS_PER_INCH, Captioned, of_other_pages
    from strandline.report.warnings import find_warnings
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["FIGURES", "PANELS", "add_check", "remove_report", "template", "write_answer", "write_report"]
