#!/usr/bin/env bash
# EXPECTED: GaussianProcessRegressor(alpha=sd**2, normalize_y=True): alpha is the variance of the noise of y, and
#           normalize_y makes the answer independent of the unit of y.
# HAPPENS:  alpha is added after y has been divided by its standard deviation, and is not divided itself. The same data
#           in m, mm and um, with the noise given in the same unit, give three answers: in m the noise counts as 0 and
#           the curve runs through all of it with a tiny sd, in um the data count as noise and are ignored.
#           Without normalize_y (and with a prior of the right size) the unit makes no difference.
# VERSION:  scikit-learn 1.9.1.
# MATTERS:  As a surrogate of a shape in metres it claims an accuracy that it has not, and the posterior of the
#           calibrated input is too narrow and in the wrong place. Nothing is printed; the fit looks perfect.
# Exits 1 once the behaviour changes.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check scikit-learn==1.9.1 scipy==1.17.1 numpy==2.4.6
cd "$work"
OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 venv/bin/python -W error - <<'PYTHON'
import numpy as np
import sklearn
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

print(f"scikit-learn {sklearn.__version__}")
rng = np.random.default_rng(0)
x = np.linspace(0, 1, 25)
truth = 300e-6 * np.sin(5 * x)  # the height of a front, in metres
noise = 20e-6
y = truth + noise * rng.standard_normal(len(x))
print(f"height of a front: {1e6 * np.ptp(truth):.0f} um from lowest to highest, noise {1e6 * noise:.0f} um (sd)\n")
print("normalize_y  unit  rms error [um]  stated sd [um]  rms of error / stated sd (should be about 1)")
score, error = {}, {}
for normal in (False, True):
    for unit, scale in {"m": 1.0, "mm": 1e3, "um": 1e6}.items():
        prior = 1.0 if normal else (scale * 200e-6) ** 2
        kernel = ConstantKernel(prior, "fixed") * RBF(0.3, "fixed")
        process = GaussianProcessRegressor(kernel, alpha=(scale * noise) ** 2, normalize_y=normal, optimizer=None)
        mean, sd = process.fit(x[:, None], scale * y).predict(x[:, None], return_std=True)
        off, sd = mean / scale - truth, sd / scale
        error[normal, unit] = 1e6 * np.sqrt(np.mean(off**2))
        score[normal, unit] = np.sqrt(np.mean((off / sd) ** 2))
        shown = f"{error[normal, unit]:15.2f} {1e6 * sd.mean():15.4g} {score[normal, unit]:10.3g}"
        print(f"{normal!s:11}  {unit:4} {shown}")

plain = [score[False, unit] for unit in ("m", "mm", "um")]
assert np.ptp(plain) < 1e-3 and 0.5 < plain[0] < 2
assert score[True, "m"] > 100, "changed: alpha in metres"
assert error[True, "um"] > 5 * error[False, "um"], "changed: alpha in micrometres"
print("\nstill so: with normalize_y, alpha has no unit")
PYTHON
