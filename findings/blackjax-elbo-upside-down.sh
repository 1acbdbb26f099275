#!/usr/bin/env bash
# EXPECTED: MFVIInfo.elbo and FRVIInfo.elbo are what their docstrings say, the "ELBO of approximation wrt target
#           distribution": a lower bound of the log evidence, the larger the better.
# HAPPENS:  Both are the loss, minus the bound. They fall while the fit gets better, and the worse fit has the larger
#           one. With a known log evidence of 3, `elbo` ends at -3 for the family that contains the posterior, and at
#           -2.2 for independent coefficients, whose standard deviations are 0.44 times the true ones.
# VERSION:  BlackJAX 1.7.1, its mean-field and full-rank variational inference.
# MATTERS:  Who keeps the fit with the largest `elbo`, of several families, starts or rates, keeps the worst.
#           Neighbouring parts of a specimen compensate for one another, and the intervals of their stiffness come out
#           at less than half the width. Nothing is printed. Take minus `elbo`.
# Exits 1 once the behaviour changes.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --disable-pip-version-check blackjax==1.7.1 jax==0.10.2 numpy==2.4.6 scipy==1.17.1
cd "$work"
OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 venv/bin/python -W error - <<'PYTHON'
from importlib.metadata import version

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
import optax

print(f"BlackJAX {version('blackjax')}")
jax.config.update("jax_enable_x64", True)
EVIDENCE = 3.0  # its logarithm
covariance = jnp.array([[1.0, -0.9], [-0.9, 1.0]])  # of two stiffnesses side by side that compensate for one another


def log_joint(x):
    return EVIDENCE + jax.scipy.stats.multivariate_normal.logpdf(x, jnp.zeros(2), covariance)


print("family        first `elbo`  last `elbo`  true bound  fitted sds, true ones are 1")
last, sds = {}, {}
for name, family in {"independent": blackjax.meanfield_vi, "full rank": blackjax.fullrank_vi}.items():
    method = family(log_joint, optax.adam(optax.cosine_decay_schedule(0.05, 2000)), 100)
    state = method.init(jnp.zeros(2))

    def step(state, key, method=method):
        state, info = method.step(key, state)
        return state, info.elbo

    state, elbo = jax.lax.scan(step, state, jax.random.split(jax.random.key(0), 2000))
    draws = np.asarray(method.sample(jax.random.key(1), state, 200_000))
    fitted = np.cov(draws.T) if name == "full rank" else np.diag(draws.var(axis=0))
    entropy = 0.5 * np.linalg.slogdet(2 * np.pi * np.e * fitted)[1]
    bound = float(np.mean(jax.vmap(log_joint)(draws))) + entropy
    last[name], sds[name] = float(elbo[-100:].mean()), draws.std(axis=0)
    print(f"{name:12}  {elbo[0]:12.2f}  {last[name]:11.2f}  {bound:10.2f}  {sds[name].round(2)}")
    assert abs(last[name] + bound) < 0.05, "changed: `elbo` is not minus the bound"
    assert bound < EVIDENCE + 0.05

best = max(last, key=last.get)
assert best == "independent" and sds[best].max() < 0.5 and abs(sds["full rank"].max() - 1) < 0.05
print(f"\nstill so: the largest `elbo` is that of the worse fit, {best}")
PYTHON
