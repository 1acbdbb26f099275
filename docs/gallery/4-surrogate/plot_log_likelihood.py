"""
A surrogate of the log-likelihood
=================================

A Gaussian process learns the log-likelihood of one input from eight runs; the band is two standard deviations.
"""

import numpy as np

import strandline as sl
from strandline.report.plots import plot_profile

stiffness = sl.Parameter("E", sl.Uniform(200.0, 800.0), "Pa")
runs = np.array([260.0, 300.0, 340.0, 400.0, 480.0, 560.0, 650.0, 780.0])[:, None]


def log_likelihood(E):
    """Return log L for a beam whose deflection 200/E mm is known to 0.1 mm."""
    return -0.5 * ((200.0 / E - 0.5) / 0.1) ** 2


gp = sl.fit_log_likelihood(runs, log_likelihood(runs[:, 0])).process
E = np.linspace(240.0, 800.0, 200)
plot_profile(stiffness, E, gp.mean(E[:, None]), sd=np.sqrt(gp.variance(E[:, None])), truth=400.0)
