"""Posteriors at a prompt and in a notebook."""

import numpy as np

from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.typeset import html_table


def posterior(dim: int) -> Posterior:
    space = ParameterSpace(tuple(Parameter(f"k<{i}", Uniform(0.0, 1000.0), "mm^2/s") for i in range(dim)))
    draws = 400.0 + 30.0 * np.random.default_rng(1).standard_normal((1000, dim))
    zeros = np.zeros(1000)
    return Posterior(space, draws, zeros - np.log(1000), zeros, zeros, 0.0)


def test_a_posterior_has_one_line_and_a_table() -> None:
    line = repr(posterior(1))
    assert line.replace("\u00a0", " ") == "<Posterior k<0 = 398 ± 30 mm² s⁻¹; 1000 particles, ESS 1000>"
    line = repr(posterior(12))
    assert ", and 4 more;" in line
    assert "\n" not in line
    assert len(line) < 400
    table = posterior(3)._repr_html_()
    assert table.count("<tr>") == 4
    assert "k&lt;0" in table
    assert "<th>5 %</th>" in table
    assert "<caption>" not in html_table(("a",), [("1",)], caption="")
    assert "<caption>a &amp; b</caption>" in html_table(("a",), [("1",)], caption="a & b")
