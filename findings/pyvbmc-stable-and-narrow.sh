#!/usr/bin/env bash
# EXPECTED: VBMC stops with success_flag True once its solution is stable; the evidence is then known to elbo_sd, and
#           means and standard deviations are about right. Six inputs with one smooth mode are well within its reach.
# HAPPENS:  A beam of six segments whose stiffnesses are to be found from its measured shape: it stops with success
#           after 180 to 240 evaluations and claims an elbo_sd of .02, but the standard deviations of five of the six
#           inputs are 10 to 40 % too small. The means are right to .15 sd.
# VERSION:  PyVBMC 1.5.0, defaults, plausible bounds at one prior standard deviation, as its guide advises.
# MATTERS:  Neighbouring segments compensate for one another (correlations of -0.9 to -0.6), as parts of a specimen do
#           whenever only its outline is seen. The intervals of their stiffness are then a third too short, and neither
#           the flag nor elbo_sd tells. Compare with a chain on the true model, or by importance weights.
# Exits 1 once the behaviour changes. Takes some minutes.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check pyvbmc==1.5.0 numpy==2.4.6 scipy==1.17.1
cd "$work"
OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 venv/bin/python - <<'PYTHON'
import warnings
from importlib.metadata import version

import numpy as np
from pyvbmc import VBMC

warnings.simplefilter("ignore")
print(f"PyVBMC {version('pyvbmc')}")
PRIOR, NOISE = 0.5, 0.005  # sd of the log stiffnesses; sd of the measured deflection, 1 % of that of the tip
x, ends = np.linspace(0, 1, 41)[1:], np.linspace(0, 1, 7)


def moment(s):
    """Integral of (x - s) 3 (1 - s)^2 / 2 over s: deflection at x by the bending of a clamped beam under even load."""
    return 1.5 * ((1 - x[:, None]) * (1 - s) ** 3 / 3 - (1 - s) ** 4 / 4)


low, high = (np.minimum(end, x[:, None]) for end in (ends[:-1], ends[1:]))
shape = moment(high) - moment(low)  # the deflections are linear in the compliances exp(-z) of the segments
rng = np.random.default_rng(1)
truth = PRIOR * rng.normal(size=6)
seen = shape @ np.exp(-truth) + NOISE * rng.normal(size=40)


def log_joint(z):
    misfit = np.sum((seen - np.exp(-z) @ shape.T) ** 2, axis=-1) / NOISE**2
    return -0.5 * (misfit + np.sum(z**2, axis=-1) / PRIOR**2)


def chains(seed):
    """Return mean and sd of 400 random walks of 3500 steps after 2500 to settle, with an adapted proposal."""
    rng, root, kept = np.random.default_rng(seed), 0.1 * np.eye(6), []
    at = 0.3 * PRIOR * rng.normal(size=(400, 6))
    value = log_joint(at)
    for step in range(6000):
        if step % 200 == 199 and step < 2500:
            root = np.linalg.cholesky(np.cov(at.T)) * 2.38 / np.sqrt(6)
        new = at + rng.normal(size=at.shape) @ root.T
        ahead = log_joint(new)
        yes = np.log(rng.random(400)) < ahead - value
        at, value = np.where(yes[:, None], new, at), np.where(yes, ahead, value)
        if step >= 2500:
            kept.append(at)
    kept = np.concatenate(kept)
    return kept.mean(axis=0), kept.std(axis=0), np.corrcoef(kept.T)


(mean, sd, together), (mean2, sd2, _) = chains(1), chains(2)
assert np.abs((mean2 - mean) / sd).max() < 0.05 and np.abs(sd2 / sd - 1).max() < 0.05, "the chains have not settled"
print(f"chains: two sets agree to {np.abs((mean2 - mean) / sd).max():.2f} sd; sds {sd.round(3)}")
print(f"correlation of neighbours {np.diag(together, 1).round(2)}\n")
print("seed  evaluations  success  elbo_sd  mean off [sd]  sd / that of the chains, by segment")
for seed in (1, 3):
    options = {"display": "off", "show_tips": False}
    wide, one = np.full(6, np.inf), np.full(6, PRIOR)
    found, how = VBMC(log_joint, np.zeros(6), -wide, wide, -one, one, seed=seed, options=options).optimize()
    at, covariance = found.moments(200_000, orig_flag=True, cov_flag=True)
    ratio, off = np.sqrt(np.diag(covariance)) / sd, np.abs((np.ravel(at) - mean) / sd).max()
    count = how["func_count"]
    print(f"{seed:4}  {count:11}  {how['success_flag']!s:7}  {how['elbo_sd']:7.3f}  {off:13.2f}  {ratio.round(2)}")
    assert how["success_flag"] and ratio.min() < 0.75 and off < 0.3, "changed: no success, or sds that are right"
print("\nstill so: success, and sds that are a quarter too small or more")
PYTHON
