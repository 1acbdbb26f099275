"""What the tests of claims share."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import logsumexp
from verification.reproduction.judgement import Claim

from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior


def settled(claim: Claim, verdict: str, *figures: str) -> Mapping[str, Any]:
    """Return the numbers of a claim as JSON gives them back, its verdict and the figures in its reason checked."""
    content = json.loads(json.dumps(claim.as_json(), allow_nan=False))
    assert content["verdict"] == claim.verdict == verdict
    assert claim.because.endswith(".")
    for figure in figures:
        assert figure in claim.because
    numbers: Mapping[str, Any] = content["numbers"]
    return numbers


def weighted_draws(space: ParameterSpace, draws: np.ndarray, values: np.ndarray) -> Posterior:
    """Return draws with the weights of a log-density, which is the likelihood too."""
    return Posterior(space, draws, values - logsumexp(values), values, np.zeros(len(draws)), 0.0)
