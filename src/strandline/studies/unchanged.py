"""Whether the results in a study's folder are those that running it again would give."""

import json
from typing import Any

from strandline.errors import StrandlineError
from strandline.report import FIGURES
from strandline.runs.soundness import outcome_digest
from strandline.studies.folder import POSTERIOR, REPORT, SUMMARY
from strandline.studies.provenance import observation_digest
from strandline.studies.study import Study
from strandline.studies.summary import versions
from strandline.version import __version__

__all__ = ["results_at_hand"]


def results_at_hand(study: Study) -> dict[str, Any] | None:
    """Return the summary of the results in the folder if nothing that they depend on has changed, else None.

    They depend on study.yaml, the model, the observation with its noise, the outcomes of all runs, and on the versions
    of strandline and of the libraries that compute.
    """
    try:
        summary = json.loads((study.folder / SUMMARY).read_text(encoding="utf-8"))
        study.runs.require_finished()
        now = {
            "study_sha256": study.text_digest,
            "model": study.runs.identity,
            "observation_sha256": observation_digest(study),
            "ledger_sha256": outcome_digest(study.ledger_path, frozenset(study.runs.needed_keys)),
            "version": __version__,
            "versions": versions(),
            "missing": {},
        }
    except (OSError, ValueError, StrandlineError):
        return None
    names = (POSTERIOR, REPORT, FIGURES) if study.with_report else (POSTERIOR,)
    written = all((study.folder / name).exists() for name in names)
    if not written or not isinstance(summary, dict) or any(summary.get(key) != value for key, value in now.items()):
        return None
    runs = summary["runs"]
    return summary | {"runs": runs | {"new": 0, "reused": runs["new"] + runs["reused"]}}
