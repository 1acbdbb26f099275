"""The posterior as weighted draws, and what is read off them."""

from strandline.posterior.gaussian import GaussianApproximation
from strandline.posterior.kde import KernelDensity
from strandline.posterior.laplace import LaplaceApproximation, laplace, log_prior_hessian
from strandline.posterior.marginals import Histogram, Histogram2D, histogram, histogram_2d, histogram_mode
from strandline.posterior.netcdf import from_datatree, read, to_datatree, write
from strandline.posterior.posterior import Posterior, systematic_indices

__all__ = [
    "GaussianApproximation",
    "Histogram",
    "Histogram2D",
    "KernelDensity",
    "LaplaceApproximation",
    "Posterior",
    "from_datatree",
    "histogram",
    "histogram_2d",
    "histogram_mode",
    "laplace",
    "log_prior_hessian",
    "read",
    "systematic_indices",
    "to_datatree",
    "write",
]
