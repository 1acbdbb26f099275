"""A finished study, whose report a person reads."""

import pytest
from tests.study.conftest import Finished, finish


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    measures = [{"tracked_points": {}}, {"closest_point": {}}]
    return finish(tmp_path_factory.mktemp("reported") / "beam", discrepancy=measures, design={"sobol": {"runs": 32}})
