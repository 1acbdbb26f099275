"""The posterior as weighted draws, and what is computed from them."""

from strandline.posterior.against_prior import FLAT, prior_conflicts
from strandline.posterior.gaussian import GaussianApproximation
from strandline.posterior.importance import Reweighting, reweight, subset
from strandline.posterior.kde import KernelDensity
from strandline.posterior.laplace import LaplaceApproximation, laplace, log_prior_hessian
from strandline.posterior.marginals import Histogram, Histogram2D, histogram, histogram_2d, histogram_mode
from strandline.posterior.netcdf import cut_from_datatree, from_datatree, read, to_datatree, write
from strandline.posterior.pareto_smoothing import (
    NEARLY_EQUAL,
    SmoothedWeights,
    Verdict,
    largest_usual_k_hat,
    pareto_smoothed,
    reliability_threshold,
    verdict_on,
)
from strandline.posterior.posterior import Posterior, systematic_indices
from strandline.posterior.predictive import (
    InterfaceBand,
    Offsets,
    interface_band,
    normal_offsets,
    observed_offsets,
)
from strandline.posterior.sensitivity import SobolIndices, sobol_indices
from strandline.posterior.under_uncertainty import (
    Cut,
    Reading,
    UnderUncertainty,
    mode_bins,
    nuisance_values,
    pooled,
)

__all__ = [
    "FLAT",
    "NEARLY_EQUAL",
    "Cut",
    "GaussianApproximation",
    "Histogram",
    "Histogram2D",
    "InterfaceBand",
    "KernelDensity",
    "LaplaceApproximation",
    "Offsets",
    "Posterior",
    "Reading",
    "Reweighting",
    "SmoothedWeights",
    "SobolIndices",
    "UnderUncertainty",
    "Verdict",
    "cut_from_datatree",
    "from_datatree",
    "histogram",
    "histogram_2d",
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
