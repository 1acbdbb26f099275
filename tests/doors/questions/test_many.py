"""Specimens that several processes share: the same to the bit, and what a process that ends early leaves."""

import sys

import numpy as np
import pytest
from tests.unit.questions.test_specimen import OUTLINE, begin

from strandline.discrepancy import NormalOffset
from strandline.foundations import NumericsError
from strandline.questions.many import RefusedSpecimen, Task, posteriors_of


def found(processes):
    tasks = [Task(name, (OUTLINE,), {"lean": 9.0} if name == "odd" else {}) for name in ("a", "odd", "b")]
    return list(posteriors_of(begin(), NormalOffset(), tasks, processes=processes))


@pytest.mark.smoke
def test_processes_answer_to_the_same_bits():
    for alone, shared in zip(found(1), found(2), strict=True):
        assert alone.name == shared.name
        if isinstance(alone, RefusedSpecimen):
            assert alone == shared
        else:
            np.testing.assert_array_equal(alone.draws, shared.draws)


def test_a_process_that_ends_early_is_named(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/true")
    with pytest.raises(NumericsError, match=r"ended early\. Run the command again: what is finished is kept"):
        found(2)
