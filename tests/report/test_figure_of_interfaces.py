"""Which interfaces the report draws beside the observed one."""

from dataclasses import replace
from typing import Any

import numpy as np

from strandline.interface import Interface
from strandline.report.figures import BEST, _data


def test_runs_are_drawn_where_the_observation_has_other_nodes_and_no_rest_is_known(reported: Any) -> None:
    calibration = reported.outcome.calibration
    problem = calibration.problem
    assert not hasattr(problem.model, "undeformed")
    (seen,) = problem.observations
    coarser = replace(seen, interface=Interface.polyline(seen.interface.points[::4]))
    (shown,) = _data(replace(calibration, problem=replace(problem, observations=(coarser,))), None)
    assert "undeformed" not in shown.caption
    (ax,) = shown.figure.axes
    lines = {str(line.get_label()): np.asarray(line.get_xydata()) for line in ax.lines}
    assert len(lines["observed"]) == len(coarser.interface.points)
    best = next(line for label, line in lines.items() if label.startswith(BEST))
    measured = calibration.log_likelihoods["tracked_points"]
    ok = [record for record in calibration.records if record.ok]
    np.testing.assert_array_equal(best, ok[int(np.argmax(measured))].interfaces[""].points)
    assert len(lines) >= 4
