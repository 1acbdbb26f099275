"""A right model is flagged in one case of twenty at most."""

import pytest
from tests.unit.calibration.test_misfit import ALL, FULL, LOCAL, flagged

from strandline.interface import PointErrors


@pytest.mark.long
@pytest.mark.parametrize("errors", [LOCAL, ALL], ids=["local", "all"])
def test_a_right_model_is_flagged_in_one_case_of_twenty_at_most(errors: PointErrors) -> None:
    assert flagged(errors, 200, FULL) <= 10
