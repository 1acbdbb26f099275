"""Posteriors at a prompt and in a notebook."""

import numpy as np
import pytest

from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.typeset import html_table


def posterior(dim: int) -> Posterior:
    names = [f"k<{i}" for i in range(dim)]
    space = ParameterSpace(tuple(Parameter(name, Uniform(0.0, 1000.0), "mm^2/s") for name in names))
    draws = 400.0 + 30.0 * np.random.default_rng(1).standard_normal((1000, dim))
    zeros = np.zeros(1000)
    return Posterior(space, draws, zeros - np.log(1000), zeros, zeros, 0.0)


def test_one_line_has_moments_and_units() -> None:
    line = repr(posterior(1))
    assert line.replace("\u00a0", " ") == "<Posterior k<0 = 398 ± 30 mm² s⁻¹; 1000 particles, ESS 1000>"


def test_many_inputs_stay_on_one_line() -> None:
    line = repr(posterior(12))
    assert ", and 4 more;" in line
    assert "\n" not in line
    assert len(line) < 400


def test_the_table_has_a_row_for_each_input_and_escapes_names() -> None:
    table = posterior(3)._repr_html_()
    assert table.count("<tr>") == 4
    assert "k&lt;0" in table
    assert "<th>5 %</th>" in table


@pytest.mark.parametrize("caption", ["", "a & b"])
def test_a_table_has_a_caption_only_where_it_is_given_one(caption: str) -> None:
    assert ("<caption>a &amp; b</caption>" in html_table(("a",), [("1",)], caption=caption)) == bool(caption)
