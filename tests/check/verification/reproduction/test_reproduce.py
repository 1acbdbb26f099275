"""The whole reproduction on small studies: coarse mesh, few runs, few particles. Its verdicts mean nothing here."""

import dataclasses
import json
import re
from pathlib import Path

import pytest
from verification.reproduction import STUDIES, Plan, reproduce

from strandline.errors import InvalidInput

SHIPPED = Path(__file__).parents[4] / "studies"
FEW = {"table": (6, 4, 2), "nodes": (33, 17, 11), "checks": 4, "nested": (24, 48), "larger": (100, 200)}
SMALL = Plan(**FEW, sizes=(24, 48), tests=8, draws=20)
CHANGES = {
    r"mesh: default": "mesh: coarse",
    r"sobol: \{runs: \d+\}": "sobol: {runs: 48}",
    r"refine: \{[^}]*\}": "refine: {rounds: 1, runs: 8}",
    r"particles: \d+": "particles: 200",
    r"rejuvenation_steps: \d+": "rejuvenation_steps: 3",
    r"zeta: [\d.]+": "zeta: 0.5",
    r"cut: \{values: \d+\}": "cut: {values: 2}",
}


def figures_of(claim):
    """Return the claim with nine figures of each number; the last ones depend on where arrays lie in memory."""
    return re.sub(r"\d+\.\d+(e-?\d+)?", lambda number: f"{float(number[0]):.9g}", repr(dataclasses.asdict(claim)))


@pytest.mark.long
def test_every_claim_has_a_verdict_and_the_page_every_figure_and_done_again_it_makes_no_run(tmp_path):
    for name in STUDIES:
        text = (SHIPPED / name / "study.yaml").read_text("utf-8")
        for pattern, replacement in CHANGES.items():
            text = re.sub(pattern, replacement, text)
        (tmp_path / "studies" / name).mkdir(parents=True)
        (tmp_path / "studies" / name / "study.yaml").write_text(text, "utf-8")
    made = reproduce(tmp_path / "studies", tmp_path / "results", plan=SMALL)
    content = json.loads(made.claims_file.read_text("utf-8"))
    for claim in (content[f"C{k}"] for k in range(1, 11)):
        assert claim["verdict"] in ("confirmed", "refuted", "differs")
        assert claim["numbers"]
    assert set(content["studies"]) == set(STUDIES)
    assert content["studies"]["biofilm-informed"]["runs"]["new"] == 0
    page = made.page.read_text("utf-8")
    for number in range(3, 16):
        assert re.search(rf"<b>Figure {number}[a-d, ]*[a-z]*\.</b>", page), number
    assert not re.search(r"(src|href)=\"https?:", page)
    assert "<script" not in page
    again = reproduce(tmp_path / "studies", tmp_path / "results", plan=SMALL)
    assert sum(cost.made for cost in again.evidence.costs) == 0
    assert again.claims.keys() == made.claims.keys()
    assert all(figures_of(again.claims[key]) == figures_of(one) for key, one in made.claims.items())


def test_a_missing_study_is_named(tmp_path):
    with pytest.raises(InvalidInput, match="biofilm-uniform, "):
        reproduce(tmp_path, tmp_path / "results")
    assert not (tmp_path / "results").exists()
