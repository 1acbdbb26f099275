"""Which interfaces the report draws beside the observed one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from strandline.interface import Interface
from strandline.report.figures import BEST, _data
from strandline.report.plots.interfaces import plot_interfaces


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


@pytest.mark.parametrize(("height", "stretch"), [(0.02, 15), (0.1, 3), (0.4, 1)])
def test_a_flat_interface_is_stretched_and_the_axis_says_so(height: float, stretch: int) -> None:
    x = np.linspace(0.0, 1.0, 20)
    ax = plot_interfaces(Interface.polyline(np.column_stack([x, height * x * (2 - x)])))
    assert ax.get_aspect() == stretch
    assert ax.get_ylabel() == ("y [mm]" if stretch == 1 else f"y [mm], {stretch} × stretched")
    drawn = ax.get_tightbbox().height
    assert drawn > 0.2 * ax.get_tightbbox().width
