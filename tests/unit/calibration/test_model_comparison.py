"""Bayes factors in words, probabilities of models, and the model-averaged posterior."""

import math

import numpy as np
import pytest

from strandline.calibration.evidence import Evidence
from strandline.calibration.model_comparison import CANNOT_TELL, ModelComparison, averaged, in_words
from strandline.errors import InvalidInput
from strandline.posterior.weighted import Weighted


def compared(**evidences: tuple[float, float]) -> ModelComparison:
    return ModelComparison({name: Evidence(*one) for name, one in evidences.items()})


def test_words_of_the_scale() -> None:
    for ln, error, words in (
        (0.999, 0.0, CANNOT_TELL),
        (1.0, 0.0, "positive"),
        (-1.0, 0.0, "positive"),
        (2.999, 0.1, "positive"),
        (3.0, 0.1, "strong"),
        (5.0, 0.1, "very strong"),
        (5.0, 2.5, "very strong"),
        (5.0, 2.51, CANNOT_TELL),
        (1.5, 0.8, CANNOT_TELL),
        (math.nan, 0.1, CANNOT_TELL),
        (3.0, math.nan, CANNOT_TELL),
        (math.inf, 0.1, "very strong"),
    ):
        assert in_words(ln, error) == words, (ln, error)


def test_two_of_three_are_tied() -> None:
    found = compared(a=(-4.0, 0.1), b=(-4.6, 0.1), c=(-9.5, 0.1))
    assert found.order == ("a", "b", "c")
    assert [(one.of, one.over) for one in found.factors] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert [one.words for one in found.factors] == [CANNOT_TELL, "very strong", "strong"]
    assert found.factors[0].error == pytest.approx(math.hypot(0.1, 0.1))
    assert (found.favoured, found.tied) == (None, ("a", "b"))
    assert found.verdict == "The data cannot tell a and b apart: ln B = 0.60 ± 0.14 of a over b, below 1."
    assert repr(found.factors[1]) == "<BayesFactor of a over c: ln B = 5.5 ± 0.14, very strong>"


def test_a_winner_beats_every_other_one_and_a_large_error_decides_nothing() -> None:
    found = compared(a=(-4.0, 0.1), b=(-6.0, 0.1), c=(-9.5, 0.1))
    assert (found.favoured, found.tied) == ("a", ("a",))
    assert found.verdict == "The data favour a over b: ln B = 2.00 ± 0.14, positive evidence."
    assert repr(found) == f"<ModelComparison: {found.verdict}>"
    found = compared(a=(0.0, 0.1), b=(-2.0, 0.1), c=(-4.0, 3.0))  # b is clearly worse, c is worse but uncertain
    assert (found.favoured, found.tied) == (None, ("a", "c"))
    assert found.verdict.startswith("The data cannot tell a and c apart: ln B = 4.00 ± 3.00 of a over c, less than 2 e")


def test_probabilities() -> None:
    even = compared(a=(-1000.0, 0.0), b=(-1001.0, 0.0))
    assert even.probabilities["a"] == pytest.approx(1 / (1 + math.exp(-1)))
    odd = ModelComparison(even.evidences, {"a": 1.0, "b": 3.0})
    assert odd.prior == {"a": 0.25, "b": 0.75}
    assert odd.probabilities["a"] == pytest.approx(1 / (1 + 3 * math.exp(-1)))
    assert odd.verdict == even.verdict, "the Bayes factor does not depend on the odds"
    for names, odds in (
        ("a", None),
        ("ab", {"a": 1.0}),
        ("ab", {"a": 1.0, "b": 0.0}),
        ("ab", {"a": 1.0, "b": math.inf}),
    ):
        with pytest.raises(InvalidInput):
            ModelComparison({name: Evidence(0.0) for name in names}, odds)


def test_the_average_has_the_moments_of_the_mixture() -> None:
    random, parts = np.random.default_rng(1), []
    for centre, number in ((0.0, 400), (3.0, 700)):
        weights = random.random(number)
        parts.append(Weighted(centre + random.standard_normal((number, 2)), weights / weights.sum()))
    found = averaged(parts, [0.2, 0.8])
    mean = 0.2 * parts[0].mean + 0.8 * parts[1].mean
    np.testing.assert_allclose(found.mean, mean)
    inside = 0.2 * parts[0].sd ** 2 + 0.8 * parts[1].sd ** 2
    between = 0.2 * (parts[0].mean - mean) ** 2 + 0.8 * (parts[1].mean - mean) ** 2
    np.testing.assert_allclose(found.sd**2, inside + between)
