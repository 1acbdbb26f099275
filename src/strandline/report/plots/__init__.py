"""Figures: each function draws data in given Axes or new ones, and returns them; several panels are a new Figure.

True values are by name; `names` are inputs, by default all.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.report.plots.answers import (
        OffsetBand,
        plot_alternatives,
        plot_averaged,
        plot_candidates,
        plot_caterpillar,
        plot_check,
        plot_directions,
        plot_intervals,
        plot_offsets,
        plot_population,
        plot_predictions,
        plot_rank_bands,
    )
    from strandline.report.plots.interfaces import (
        ResidualsAlong,
        plot_conditions,
        plot_flow,
        plot_interfaces,
        plot_residuals,
        plot_run_offsets,
    )
    from strandline.report.plots.joint import plot_hexagons, plot_joint, plot_marginal, plot_marginals, plot_particles
    from strandline.report.plots.pairs import plot_corner, plot_failed_runs, plot_parallel
    from strandline.report.plots.random_field import plot_random_field
    from strandline.report.plots.style import mark_doubt
    from strandline.report.plots.surrogate import (
        ErrorsAlong,
        FieldGrid,
        Kind,
        plot_field,
        plot_field_error,
        plot_leave_one_out,
        plot_run_history,
        plot_sensitivity,
        plot_tempering,
        three_measures,
    )
else:
    __getattr__ = door(__name__, __file__)

__all__ = [
    "ErrorsAlong", "FieldGrid", "OffsetBand", "ResidualsAlong", "mark_doubt", "plot_alternatives", "plot_averaged",
    "plot_candidates", "plot_caterpillar", "plot_check", "plot_conditions", "plot_corner", "plot_directions",
    "plot_failed_runs", "plot_field", "plot_field_error", "plot_flow", "plot_hexagons", "plot_interfaces",
    "plot_intervals", "plot_joint", "plot_leave_one_out", "plot_marginal", "plot_marginals", "plot_offsets",
    "plot_parallel", "plot_particles", "plot_population", "plot_predictions", "plot_random_field", "plot_rank_bands",
    "plot_residuals",
    "plot_run_history", "plot_run_offsets", "plot_sensitivity", "plot_tempering", "three_measures",
]  # fmt: skip
