"""Candidates in words, and which of them there are."""

from strandline.planning.candidate import Candidate, Look, candidates


def test_all_combinations_alone_and_together() -> None:
    found = candidates({"V_in": [50.0, 125.0]}, [Look(), Look(points=20)], together=2)
    labels = [one.label() for one in found]
    assert labels == [
        "V_in 50", "V_in 50, 20 points", "V_in 125", "V_in 125, 20 points",
        "V_in 50 and V_in 50", "V_in 50 and V_in 50, 20 points", "V_in 50 and V_in 125",
        "V_in 50 and V_in 125, 20 points", "V_in 125 and V_in 125", "V_in 125 and V_in 125, 20 points",
    ]  # fmt: skip


def test_several_quantities_are_set_together() -> None:
    (one,) = candidates({"V_in": [50.0], "h": [0.5]}, [Look(("slow",), (0.0, 0.5), sd=0.003)])
    assert one.label() == "V_in 50 h 0.5, condition slow, 0–50 % of the interface, sd 3 µm"
    assert one == Candidate(({"V_in": 50.0, "h": 0.5},), Look(("slow",), (0.0, 0.5), sd=0.003))


def test_nothing_to_set_is_the_same_experiment() -> None:
    (one,) = candidates({}, [Look()])
    assert one.label() == "the same again"
    assert one.label("as planned") == "as planned"


def test_conditions_of_the_model_alone() -> None:
    (one,) = candidates({}, [Look(("slow", "fast"), points=20)])
    assert one.label() == "conditions slow and fast, 20 points"


def test_present_values_and_values_given_twice_are_one_candidate() -> None:
    found = candidates({"V_in": [50.0, 100.0, 50.0]}, [Look()], together=2, present={"V_in": 100.0})
    assert [one.label() for one in found] == [
        "V_in 50", "the same again", "V_in 50 and V_in 50", "V_in 50 and the same again",
        "the same again, twice",
    ]  # fmt: skip
