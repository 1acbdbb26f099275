"""
A surrogate of the log-likelihood
=================================

A Gaussian process learns the log-likelihood of one input from eight runs; the band is two standard deviations.
"""

import matplotlib.pyplot as plt
import numpy as np

import strandline as sl

stiffness = sl.Parameter("E", sl.Uniform(200.0, 800.0), "Pa")
runs = np.array([260.0, 300.0, 340.0, 400.0, 480.0, 560.0, 650.0, 780.0])[:, None]


def log_likelihood(E):
    """Return log L for a beam whose deflection 200/E mm is known to 0.1 mm."""
    return -0.5 * ((200.0 / E - 0.5) / 0.1) ** 2


gp = sl.fit_log_likelihood(runs, log_likelihood(runs[:, 0])).process
E = np.linspace(240.0, 800.0, 200)
mean, sd = gp.mean(E[:, None]), np.sqrt(gp.variance(E[:, None]))
figure, ax = plt.subplots(figsize=(3.5, 2.7), layout="constrained")
ax.plot(E, mean, "k")
ax.fill_between(E, mean - 2 * sd, mean + 2 * sd, color="grey", alpha=0.4, label="± 2 sd")
ax.axvline(400.0, color="tab:red", linestyle=":", label="ground truth")
ax.set(xlabel=stiffness.figure_label(), ylabel="log-likelihood")
ax.legend()
figure
