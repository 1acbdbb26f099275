"""The whole reproduction on small studies: coarse mesh, few runs, few particles. Its verdicts mean nothing here."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import pytest
from verification.reproduction import STUDIES, Plan, Reproduction, reproduce

from strandline.errors import InvalidInput

pytestmark = pytest.mark.xdist_group("reproduction")  # one process makes what all of them look at
SHIPPED = Path(__file__).parents[4] / "studies"
SMALL = Plan(
    table=(6, 4, 2), nodes=(33, 17, 11), checks=4, nested=(24, 48), larger=(100, 200), sizes=(24, 48), tests=8, draws=20
)  # fmt: skip
CHANGES = {
    r"mesh: default": "mesh: coarse",
    r"sobol: \{runs: \d+\}": "sobol: {runs: 48}",
    r"refine: \{[^}]*\}": "refine: {rounds: 1, runs: 8}",
    r"particles: \d+": "particles: 200",
    r"rejuvenation_steps: \d+": "rejuvenation_steps: 3",
    r"zeta: [\d.]+": "zeta: 0.5",
    r"cut: \{values: \d+\}": "cut: {values: 2}",
}


def small_studies(folder: Path) -> Path:
    """Copy the shipped studies with everything small."""
    for name in STUDIES:
        text = (SHIPPED / name / "study.yaml").read_text("utf-8")
        for pattern, replacement in CHANGES.items():
            text = re.sub(pattern, replacement, text)
        (folder / name).mkdir(parents=True)
        (folder / name / "study.yaml").write_text(text, "utf-8")
    return folder


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Reproduction]:
    folder = tmp_path_factory.mktemp("reproduction")
    return folder, reproduce(small_studies(folder / "studies"), folder / "results", plan=SMALL)


@pytest.mark.long
def test_every_claim_has_a_verdict_and_the_page_every_figure(small: tuple[Path, Reproduction]) -> None:
    content = json.loads(small[1].claims_file.read_text("utf-8"))
    keys = [f"C{k}" for k in range(1, 11)]
    assert [key for key in content if key[1:].isdigit()] == keys
    for key in keys:
        claim = content[key]
        assert claim["verdict"] in ("confirmed", "refuted", "differs")
        assert claim["numbers"]
        assert claim["because"].endswith(".")
    assert set(content["studies"]) == set(STUDIES)
    assert content["studies"]["biofilm-informed"]["runs"]["new"] == 0

    page = small[1].page.read_text("utf-8")
    for number in range(3, 16):
        assert re.search(rf"<b>Figure {number}[a-d, ]*[a-z]*\.</b>", page), number
    assert not re.search(r"(src|href)=\"https?:", page)
    assert "<script" not in page


def rounded(claim: Any) -> str:
    """Return the claim with nine figures of each number; the last ones depend on where arrays lie in memory."""
    return re.sub(r"\d+\.\d+(e-?\d+)?", lambda number: f"{float(number[0]):.9g}", repr(dataclasses.asdict(claim)))


@pytest.mark.long
def test_done_again_it_makes_no_run_and_finds_the_same(small: tuple[Path, Reproduction]) -> None:
    folder, first = small
    again = reproduce(folder / "studies", folder / "results", plan=SMALL)
    assert sum(cost.made for cost in again.evidence.costs) == 0
    assert {key: rounded(one) for key, one in again.claims.items()} == {
        key: rounded(one) for key, one in first.claims.items()
    }


def test_a_missing_study_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="biofilm-uniform, "):
        reproduce(tmp_path, tmp_path / "results")
    assert not (tmp_path / "results").exists()
