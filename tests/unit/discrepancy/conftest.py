"""Measures are computed in double precision, also if a file of tests runs alone."""

import pytest

from strandline.foundations import use_double


@pytest.fixture(autouse=True, scope="session")
def _double() -> None:
    use_double()
