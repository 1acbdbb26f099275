"""The order of the figures on the page of the reproduction."""

from verification.reproduction.page import _place
from verification.reproduction.pictures import FROM_REPORTS, Picture


def test_figures_stand_in_the_order_of_their_numbers() -> None:
    drawn = [*(entry[0] for entry in FROM_REPORTS), "8", "8, refined", "8, errors", "11", "12", "12, likelihood"]
    ordered = [p.number for p in sorted((Picture(number, "", b"") for number in drawn), key=_place)]
    assert ordered[:6] == ["3", "4", "5", "6", "7", "8"]
    middle = ["9a", "9a, refined", "9b", "9c", "9d", "9d, cut", "10", "11", "12", "12, likelihood", "13", "14", "15"]
    assert ordered[-len(middle) :] == middle
