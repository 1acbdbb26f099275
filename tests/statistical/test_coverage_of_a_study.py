"""The intervals of a study of the beam contain the truth as often as they should."""

import dataclasses
from pathlib import Path

import pytest

import strandline as sl
from strandline.discrepancy import NormalOffset
from strandline.interface import PointErrors
from strandline.questions.coverage import coverage
from strandline.testing.studies import write_study

pytestmark = pytest.mark.long


def test_the_beam_is_calibrated(tmp_path: Path) -> None:
    """With all draws of the prior, and independent errors along the normals of another measure."""
    sampler = {"smc": {"particles": 2000, "rejuvenation_steps": 4}}
    study = sl.load_study(write_study(tmp_path / "beam", sampler=sampler, draft=True))
    sl.run_study(study, executor=sl.InProcess())
    errors = dataclasses.replace(study, noise=PointErrors(0.003), discrepancies={"offset": NormalOffset()})
    for one in (study, errors):
        content = coverage(one, replicates=200).content
        assert min(item["p_value"] for item in content["inputs"].values()) > 1e-3
        assert all(0.85 < item["z_sd"] < 1.18 for item in content["inputs"].values())
