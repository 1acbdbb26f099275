"""The whole reproduction on small studies: coarse mesh, few runs, few particles. Its verdicts mean nothing here."""

import json
import re
from pathlib import Path

import pytest
from verification.reproduction import STUDIES, Plan, reproduce

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
    assert content["studies"]["biofilm-informed"]["runs"]["new"] == 0
    page = made.page.read_text("utf-8")
    for number in range(3, 16):
        assert re.search(rf"<b>Figure {number}[a-d, ]*[a-z]*\.</b>", page), number
    assert not re.search(r"(src|href)=\"https?:|<script", page)
    again = reproduce(tmp_path / "studies", tmp_path / "results", plan=SMALL)
    assert sum(cost.made for cost in again.evidence.costs) == 0
    assert [claim.verdict for claim in again.claims.values()] == [claim.verdict for claim in made.claims.values()]
