"""Figures: each function takes data and an optional Axes (or Figure, for several panels) and returns it."""

from strandline.report.plots.candidates import plot_candidates, plot_directions
from strandline.report.plots.check import OffsetBand, plot_check, plot_offsets
from strandline.report.plots.comparison import ModelMarginals, plot_averaged, plot_model_marginals, plot_predictions
from strandline.report.plots.convergence import plot_convergence
from strandline.report.plots.corner import plot_corner
from strandline.report.plots.coverage import IntervalCoverage, plot_intervals, plot_rank_band, plot_rank_bands
from strandline.report.plots.failed_runs import plot_failed_runs
from strandline.report.plots.field import FieldGrid, plot_field, plot_profile, three_measures
from strandline.report.plots.field_error import ErrorsAlong, plot_field_error
from strandline.report.plots.flow import FlowFields, plot_flow
from strandline.report.plots.interfaces import plot_conditions, plot_interfaces
from strandline.report.plots.joint import plot_hexagons, plot_joint, plot_pairs, plot_selected_pairs
from strandline.report.plots.leave_one_out import plot_leave_one_out
from strandline.report.plots.marginals import Curve, plot_marginal, plot_marginals
from strandline.report.plots.offsets import plot_run_offsets
from strandline.report.plots.parallel import plot_parallel
from strandline.report.plots.particles import plot_particles
from strandline.report.plots.parts import plot_parts
from strandline.report.plots.residuals import ResidualsAlong, plot_residuals
from strandline.report.plots.run_history import RunHistory, plot_run_history
from strandline.report.plots.sensitivity import plot_sensitivity
from strandline.report.plots.specimens import (
    PopulationDensity,
    SpecimenIntervals,
    plot_caterpillar,
    plot_population,
)
from strandline.report.plots.style import mark_doubt
from strandline.report.plots.tempering import plot_tempering
from strandline.report.plots.what_if import Whisker, plot_alternatives

__all__ = [
    "Curve",
    "ErrorsAlong",
    "FieldGrid",
    "FlowFields",
    "IntervalCoverage",
    "ModelMarginals",
    "OffsetBand",
    "PopulationDensity",
    "ResidualsAlong",
    "RunHistory",
    "SpecimenIntervals",
    "Whisker",
    "mark_doubt",
    "plot_alternatives",
    "plot_averaged",
    "plot_candidates",
    "plot_caterpillar",
    "plot_check",
    "plot_conditions",
    "plot_convergence",
    "plot_corner",
    "plot_directions",
    "plot_failed_runs",
    "plot_field",
    "plot_field_error",
    "plot_flow",
    "plot_hexagons",
    "plot_interfaces",
    "plot_intervals",
    "plot_joint",
    "plot_leave_one_out",
    "plot_marginal",
    "plot_marginals",
    "plot_model_marginals",
    "plot_offsets",
    "plot_pairs",
    "plot_parallel",
    "plot_particles",
    "plot_parts",
    "plot_population",
    "plot_predictions",
    "plot_profile",
    "plot_rank_band",
    "plot_rank_bands",
    "plot_residuals",
    "plot_run_history",
    "plot_run_offsets",
    "plot_selected_pairs",
    "plot_sensitivity",
    "plot_tempering",
    "three_measures",
]
