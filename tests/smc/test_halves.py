"""Two runs joined into one sample."""

import numpy as np
import pytest

from strandline.smc import SMCResult, StepInfo
from strandline.smc.halves import joined

STEPS = (StepInfo(1.0, 900.0, 0.3, True, -3.0, 1.0),)


def run(number: int, at: float, log_evidence: float) -> SMCResult:
    x, equal = np.full((number, 1), at), np.full(number, -np.log(number))
    return SMCResult(x, equal, np.zeros(number), np.zeros(number), log_evidence, float(number), STEPS, 10 * number)


@pytest.mark.parametrize("log_evidence", [-4.0, 0.0, 300.0])
def test_runs_count_by_their_evidence(log_evidence: float) -> None:
    """The second run has three times the particles and a third of the evidence of the first."""
    both = joined(run(100, 0.0, log_evidence + np.log(3)), run(300, 1.0, log_evidence))
    weights = np.exp(both.log_weights)
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ both.positions[:, 0] == pytest.approx(0.5)
    assert both.log_evidence == pytest.approx(log_evidence + np.log(1.5))
    assert both.ess == pytest.approx(1 / (0.25 / 100 + 0.25 / 300))
    assert both.likelihood_evaluations == 4000
