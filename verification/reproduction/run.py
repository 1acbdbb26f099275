"""Reproduce the whole published study: run its six examples, judge its ten claims, write one page."""

import time
from dataclasses import dataclass
from pathlib import Path

from verification.reproduction.evidence import Evidence, Plan, gather, require_studies
from verification.reproduction.judge import judge
from verification.reproduction.judgement import Claim
from verification.reproduction.page import write_claims, write_page
from verification.reproduction.pictures import draw

from strandline.calibration import Observer
from strandline.runs import Executor
from strandline.studies.folder import told_if_unwritable

__all__ = ["Reproduction", "reproduce"]


@dataclass(frozen=True)
class Reproduction:
    """The evidence, the judged claims, and the paths of the files."""

    evidence: Evidence
    claims: dict[str, Claim]
    page: Path
    claims_file: Path


def reproduce(
    studies: Path,
    folder: Path,
    *,
    plan: Plan | None = None,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> Reproduction:
    """Run everything, judge the claims, and write report.html and claims.json into `folder`.

    Forward runs that a ledger holds are not repeated: a second call goes on where the first one stopped.

    Args:
        studies: Folder that holds the study folders.
        folder: Folder of the results; created if it does not exist.
        plan: Extent of the work in addition to the studies.
        executor: Executor of forward runs; by default that of the studies.
        observer: Observer of the progress.

    Raises:
        InvalidInput: A study is missing; also everything that `run_study` and `check_posterior` raise.
    """
    begun, tell = time.perf_counter(), observer or Observer()
    require_studies(studies)
    with told_if_unwritable(folder):
        folder.mkdir(parents=True, exist_ok=True)
    evidence = gather(studies, folder, plan=plan or Plan(), executor=executor, observer=tell)
    claims = judge(evidence)
    tell.stage("page")
    pictures = list(draw(evidence))
    seconds = time.perf_counter() - begun
    page = write_page(evidence, claims, pictures, folder, seconds)
    return Reproduction(evidence, claims, page, write_claims(evidence, claims, folder, seconds))
