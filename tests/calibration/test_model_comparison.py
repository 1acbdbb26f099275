"""Bayes factors in words, probabilities of models, and the model-averaged posterior."""

import math

import numpy as np
import pytest

from strandline.calibration.evidence import Evidence
from strandline.calibration.model_comparison import CANNOT_TELL, ModelComparison, averaged, in_words
from strandline.errors import InvalidInput
from strandline.posterior.weighted import Weighted


@pytest.mark.parametrize(
    ("ln", "error", "words"),
    [
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
    ],
)
def test_words_of_the_scale(ln: float, error: float, words: str) -> None:
    assert in_words(ln, error) == words


def three(**changes: float) -> ModelComparison:
    logs = {"a": -4.0, "b": -4.6, "c": -9.5, **changes}
    return ModelComparison({name: Evidence(log, 0.1) for name, log in logs.items()})


def test_two_of_three_are_tied() -> None:
    found = three()
    assert found.order == ("a", "b", "c")
    assert [(one.of, one.over) for one in found.factors] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert [one.words for one in found.factors] == [CANNOT_TELL, "very strong", "strong"]
    assert found.factors[0].error == pytest.approx(math.hypot(0.1, 0.1))
    assert (found.favoured, found.tied) == (None, ("a", "b"))
    assert found.verdict == "The data cannot tell a and b apart: ln B = 0.60 ± 0.14 of a over b, below 1."
    assert repr(found.factors[1]) == "<BayesFactor of a over c: ln B = 5.5 ± 0.14, very strong>"


def test_a_winner_beats_every_other_one() -> None:
    found = three(b=-6.0)
    assert (found.favoured, found.tied) == ("a", ("a",))
    assert found.verdict == "The data favour a over b: ln B = 2.00 ± 0.14, positive evidence."
    assert repr(found) == f"<ModelComparison: {found.verdict}>"


def test_a_large_error_decides_nothing() -> None:
    found = ModelComparison({"a": Evidence(-4.0, 0.1), "b": Evidence(-6.0, 1.5)})
    assert found.favoured is None
    assert found.verdict.startswith("The data cannot tell a and b apart: ln B = 2.00 ± 1.50 of a over b, less than 2 e")


def test_the_verdict_quotes_the_pair_that_is_undecided() -> None:
    """The second model is clearly worse, the third one is worse but uncertain."""
    found = ModelComparison({"a": Evidence(0.0, 0.1), "b": Evidence(-2.0, 0.1), "c": Evidence(-4.0, 3.0)})
    assert found.tied == ("a", "c")
    assert found.verdict.startswith("The data cannot tell a and c apart: ln B = 4.00 ± 3.00 of a over c, less than 2 e")


def test_probabilities() -> None:
    even = ModelComparison({"a": Evidence(-1000.0), "b": Evidence(-1001.0)})
    assert even.probabilities["a"] == pytest.approx(1 / (1 + math.exp(-1)))
    odd = ModelComparison(even.evidences, {"a": 1.0, "b": 3.0})
    assert odd.prior == {"a": 0.25, "b": 0.75}
    assert odd.probabilities["a"] == pytest.approx(1 / (1 + 3 * math.exp(-1)))
    assert odd.verdict == even.verdict, "the Bayes factor does not depend on the odds"


@pytest.mark.parametrize(
    ("evidences", "odds"),
    [
        (["a"], None),
        (["a", "b"], {"a": 1.0}),
        (["a", "b"], {"a": 1.0, "b": 0.0}),
        (["a", "b"], {"a": 1.0, "b": math.inf}),
    ],
)
def test_what_is_refused(evidences: list[str], odds: dict[str, float] | None) -> None:
    with pytest.raises(InvalidInput):
        ModelComparison({name: Evidence(0.0) for name in evidences}, odds)


def test_the_average_has_the_moments_of_the_mixture() -> None:
    random = np.random.default_rng(1)
    parts = []
    for centre, number in ((0.0, 400), (3.0, 700)):
        weights = random.random(number)
        parts.append(Weighted(centre + random.standard_normal((number, 2)), weights / weights.sum()))
    found = averaged(parts, [0.2, 0.8])
    mean = 0.2 * parts[0].mean + 0.8 * parts[1].mean
    np.testing.assert_allclose(found.mean, mean)
    inside = 0.2 * parts[0].sd ** 2 + 0.8 * parts[1].sd ** 2
    between = 0.2 * (parts[0].mean - mean) ** 2 + 0.8 * (parts[1].mean - mean) ** 2
    np.testing.assert_allclose(found.sd**2, inside + between)
