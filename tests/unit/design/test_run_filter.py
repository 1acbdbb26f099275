"""One odd run among many is named and left out; where all are odd, the measure is to blame."""

from dataclasses import replace

import numpy as np
import pytest

from strandline.design.run_filter import RunFilter, says_whether_runs_succeed
from strandline.discrepancy import ClosestPoint, NormalOffset, TrackedPoints
from strandline.foundations import CampaignStopped, InvalidInput, InvalidInterface, NoCommonPoints
from strandline.interface import Interface, Observation, PointErrors
from strandline.runs import FailurePolicy, RunRecord

CLOSEST, TRACKED = {"closest_point": ClosestPoint()}, {"tracked_points": TrackedPoints()}


def curve(height: float, number: int = 9) -> np.ndarray:
    s = np.linspace(0.0, 1.0, number)
    return np.stack([s, height * np.sin(np.pi * s)], axis=1)


def record(number: int, points: np.ndarray, *, closed: bool = False) -> RunRecord:
    interface = Interface.polyline(points, closed=closed)
    return RunRecord(f"key{number:03d}", {"E": 300.0 + number}, "ok", {"": interface})


def regular(number: int = 20) -> list[RunRecord]:
    return [record(i, curve(0.2 + 0.01 * i)) for i in range(number)]


def judge(measures=TRACKED, **policy) -> RunFilter:
    return RunFilter((Observation(Interface.polyline(curve(0.3)), 0.01),), measures, FailurePolicy(**policy))


def test_one_odd_run_is_named_and_left_out():
    for kind, odd in (
        ("not_comparable", curve(0.3, 11)),
        ("not_comparable", curve(0.3) + 1e9),  # a million times the extent
        ("not_comparable", curve(0.3) * 1e160),
    ):
        records, found = [*regular(), record(99, odd)], judge()
        used = found.usable(records)
        assert [one.ok for one in used] == [True] * 20 + [False]
        assert (used[-1].state, used[-1].failure_kind, used[-1].interfaces) == ("invalid", kind, {})
        (aside,) = found.set_aside(records)
        assert (aside.key, aside.inputs, aside.kind) == ("key099", {"E": 399.0}, kind)
        assert not says_whether_runs_succeed(used[-1])
        assert found.set_aside(found.usable(used)) == (aside,)


def test_an_observation_in_another_unit_than_all_runs_is_refused():
    for scale, mistaken in ((1000.0, "is in µm and was read in mm"), (0.001, "is in mm and was read in µm")):
        seen = Observation(Interface.polyline(scale * curve(0.3)), 0.01)
        with pytest.raises(InvalidInput, match=f"size of the observation: .*{mistaken}"):
            RunFilter((seen,), TRACKED, FailurePolicy()).usable(regular())
        assert RunFilter((seen,), CLOSEST, FailurePolicy()).usable([*regular(), record(99, scale * curve(0.31))])


def test_good_runs_are_what_they_were():
    """Most runs flipped is how the model runs; where no run can be compared, the measure says why."""
    records, found = regular(), judge()
    assert found.usable(records) == tuple(records)
    assert found.set_aside(records) == ()
    flipped = [record(i, curve(0.3 + 0.001 * i)[::-1]) for i in range(8)]
    assert all(one.ok for one in judge().usable(flipped))
    with pytest.raises(InvalidInterface, match="do not correspond"):
        judge().usable([record(i, curve(0.3, 11)) for i in range(5)])


def test_a_run_that_runs_from_the_other_end_is_turned_round_with_its_derivatives():
    """A closed one, too, wherever it begins; a line that cannot be told from its reverse stays."""
    slope = np.arange(18.0).reshape(9, 2)
    odd = replace(record(99, curve(0.31)[::-1]), sensitivities={"": {"E": slope}})
    used = judge().usable([*regular(), odd])
    np.testing.assert_array_equal(used[-1].interface.points, curve(0.31))
    np.testing.assert_array_equal(used[-1].sensitivities[""]["E"], slope[::-1])
    assert judge().value("tracked_points", odd) == judge().value("tracked_points", record(99, curve(0.31)))
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    seen = Observation(Interface.polyline(ring, closed=True), 0.01)
    found = RunFilter((seen,), CLOSEST, FailurePolicy())
    rings = [record(i, (1 + 0.01 * i) * ring[:: -1 if i == 3 else 1], closed=True) for i in range(6)]
    assert all(not one.interface.runs_against(seen.interface) for one in found.usable(rings))


def test_the_errors_of_each_point_are_turned_with_the_points():
    errors = PointErrors.of_each(np.linspace(0.001, 0.01, 21))
    seen = Observation(Interface.polyline(curve(0.3, 21)[::-1]), errors)
    found = RunFilter((seen,), {"normal_offset": NormalOffset()}, FailurePolicy())
    found.usable(regular())
    (turned,) = found.observations
    assert found.turned == ("",)
    np.testing.assert_allclose(turned.noise.sds(turned.interface), errors.sds(seen.interface)[::-1])


def test_another_measure_leaves_out_its_runs_alone():
    records = [*regular(), record(99, curve(0.3, 11))]
    found = judge(CLOSEST | TRACKED)
    assert all(one.ok for one in found.usable(records))
    assert np.isfinite(found.value("closest_point", records[-1]))
    assert np.isnan(found.value("tracked_points", records[-1]))
    (aside,) = found.set_aside(records)
    assert (aside.key, aside.measure) == ("key099", "tracked_points")


def test_the_policy_counts_what_is_set_aside():
    records = [*regular(2), *(record(50 + i, curve(0.3, 11)) for i in range(8))]
    with pytest.raises(CampaignStopped, match=r"8 of 10(.|\n)*Correct the model and move"):
        judge(stop_after=5, stop_share=0.8).usable(records)
    with pytest.raises(CampaignStopped, match=r"key050.*not_comparable"):
        judge(actions={"not_comparable": "abort"}).usable(records)
    assert sum(one.ok for one in judge().usable(records)) == 2


def test_few_closed_interfaces_among_open_ones_are_exceptions():
    error = NoCommonPoints("interfaces", value="different", expected="alike", remedy="none")
    records, found = regular(38), judge(CLOSEST)
    records += [record(90 + i, curve(0.9 + i), closed=True) for i in range(2)]
    assert all(one.ok for one in found.usable(records))
    found.without_exceptions(records, error)
    assert [one.ok for one in found.usable(records)] == [True] * 38 + [False] * 2
    assert "closed polyline, most others are an open" in found.set_aside(records)[0].why
    found.forget_exceptions()
    assert all(one.ok for one in found.usable(records))
    for odd, height in ((3, 0.9), (1, 0.3)):  # many of 20, and the one nearest to the observation
        records = [one for one in regular() if one.inputs["E"] != 310.0]
        records += [record(90 + i, curve(height + 0.01 * i), closed=True) for i in range(odd)]
        found = judge(CLOSEST)
        found.usable(records)
        with pytest.raises(NoCommonPoints):
            found.without_exceptions(records, error)
