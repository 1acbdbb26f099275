"""Candidates in words, and which of them there are."""

from strandline.planning.candidate import Candidate, Look, candidates


def labels(*given, **options) -> list[str]:
    return [one.label() for one in candidates(*given, **options)]


def test_all_combinations_alone_and_together() -> None:
    assert labels({"V_in": [50.0, 125.0]}, [Look(), Look(points=20)], together=2) == [
        "V_in 50", "V_in 50, 20 points", "V_in 125", "V_in 125, 20 points",
        "V_in 50 and V_in 50", "V_in 50 and V_in 50, 20 points", "V_in 50 and V_in 125",
        "V_in 50 and V_in 125, 20 points", "V_in 125 and V_in 125", "V_in 125 and V_in 125, 20 points",
    ]  # fmt: skip
    assert labels({"V_in": [50.0, 100.0, 50.0]}, [Look()], together=2, present={"V_in": 100.0}) == [
        "V_in 50", "the same again", "V_in 50 and V_in 50", "V_in 50 and the same again",
        "the same again, twice",
    ], "present values and values given twice are one candidate"  # fmt: skip


def test_labels() -> None:
    look = Look(("slow",), (0.0, 0.5), sd=0.003)
    (one,) = candidates({"V_in": [50.0], "h": [0.5]}, [look])
    assert one.label() == "V_in 50 h 0.5, condition slow, 0–50 % of the interface, sd 3 µm"
    assert one == Candidate(({"V_in": 50.0, "h": 0.5},), look)
    (same,) = candidates({}, [Look()])
    assert (same.label(), same.label("as planned")) == ("the same again", "as planned")
    assert labels({}, [Look(("slow", "fast"), points=20)]) == ["conditions slow and fast, 20 points"]
