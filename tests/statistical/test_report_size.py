"""The report of a large study can be sent."""

import re
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from tests.study.report.pages import data_in

from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.testing.studies import write_study


@pytest.mark.long
def test_a_report_of_a_thousand_runs_can_be_sent(tmp_path: Path) -> None:
    """With figures for print; the files beside the page keep their resolution."""
    measures: list[dict[str, Any]] = [{"normal_offset": {}}, {"tracked_points": {}}]
    folder = write_study(tmp_path / "beam", design={"sobol": {"runs": 1000}}, discrepancy=measures)
    page = run_study(load_study(folder), executor=InProcess()).report
    assert page is not None
    assert page.stat().st_size < 5_000_000
    text = page.read_text("utf-8")
    assert len(data_in(text)["runs"]["row"]) == 1000
    assert len(re.findall("<figure", text)) == 12
    for path in (folder / "figures").glob("*.png"):
        assert path.with_suffix(".pdf").is_file()
        with Image.open(path) as picture:
            assert picture.info["dpi"] == pytest.approx((300, 300), abs=0.1)
