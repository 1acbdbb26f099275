"""The posterior as weighted draws, and what is computed from them.

In: draws and their log-densities. Out: moments, intervals, approximations, importance weights and their reliability.
"""

from strandline.posterior.densities import (
    GaussianApproximation,
    KernelDensity,
    LaplaceApproximation,
    enclosing_levels,
    laplace,
    log_prior_hessian,
)
from strandline.posterior.importance import (
    NEARLY_EQUAL,
    Reweighting,
    SmoothedWeights,
    Verdict,
    largest_usual_k_hat,
    pareto_smoothed,
    reliability_threshold,
    reweight,
    shifted,
    subset,
    verdict_on,
)
from strandline.posterior.netcdf import cut_from_datatree, from_datatree, read, to_datatree, write
from strandline.posterior.posterior import (
    FLAT,
    Histogram,
    InterfaceBand,
    Offsets,
    Posterior,
    histogram,
    histogram_mode,
    interface_band,
    normal_offsets,
    observed_offsets,
    prior_conflicts,
)
from strandline.posterior.quadrature import QuadratureResult, integrate, mixture
from strandline.posterior.random_field import FieldPosterior, Functional
from strandline.posterior.rank_tests import Band, Coverage, coverage_of, region_coverage_of, uniformity, weighted_ranks
from strandline.posterior.sensitivity import SobolIndices, sobol_indices
from strandline.posterior.under_uncertainty import (
    Cut,
    MarginalPosterior,
    UnderUncertainty,
    mode_bins,
    nuisance_values,
    pooled,
)
from strandline.posterior.weighted import Weighted, systematic_indices

__all__ = [
    "FLAT",
    "NEARLY_EQUAL",
    "Cut",
    "FieldPosterior",
    "Functional",
    "GaussianApproximation",
    "Histogram",
    "InterfaceBand",
    "KernelDensity",
    "LaplaceApproximation",
    "MarginalPosterior",
    "Offsets",
    "Posterior",
    "Reweighting",
    "SmoothedWeights",
    "SobolIndices",
    "UnderUncertainty",
    "Verdict",
    "Weighted",
    "cut_from_datatree",
    "enclosing_levels",
    "from_datatree",
    "histogram",
    "histogram_mode",
    "interface_band",
    "laplace",
    "largest_usual_k_hat",
    "log_prior_hessian",
    "mode_bins",
    "normal_offsets",
    "nuisance_values",
    "observed_offsets",
    "pareto_smoothed",
    "pooled",
    "prior_conflicts",
    "read",
    "reliability_threshold",
    "reweight",
    "sobol_indices",
    "subset",
    "systematic_indices",
    "to_datatree",
    "verdict_on",
    "write",
]
