"""Results must belong to the study.yaml in their folder, its observation and its runs."""

import dataclasses
import json
import platform
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from importlib import metadata
from typing import Any

from strandline.foundations import InvalidStudy, StrandlineError, __version__, read_json
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.report import FIGURES
from strandline.runs import FailurePolicy, outcome_digest
from strandline.studies.keys.folder import POSTERIOR, REPORT, SUMMARY
from strandline.studies.load.study import Study

PACKAGES = ("numpy", "scipy", "jax", "ngsolve", "mkl", "xarray")
FREE = frozenset({"folder", "text", "settings", "executor", "reuse", "as_loaded"})
"""Fields that change no result, and those that are compared separately."""


def require_its_own_text(study: Study) -> None:
    """Refuse a study changed since it was loaded, except executor, policy for failed runs and reused ledgers."""
    loaded = study.as_loaded
    if loaded is None or study.text != loaded.text:
        return
    fields = [field.name for field in dataclasses.fields(Study) if field.name not in FREE]
    changed = [name for name in fields if not _same(getattr(study, name), getattr(loaded, name))]
    now, then = (vars(replace(one.settings, failures=FailurePolicy())) for one in (study, loaded))
    changed += [f"settings.{name}" for name in then if not _same(now[name], then[name])]
    if changed:
        what = "the study was changed after it was loaded"
        expected = "the values of its study.yaml, since the results are stored with that file"
        remedy = "Write the change into a study.yaml, in a separate folder to keep both, and load that."
        raise InvalidStudy(what, value=", ".join(changed), expected=expected, remedy=remedy)


def observation_digest(study: Study) -> str:
    """Return a digest of the observed points and their noise; synthetic ones follow from study.yaml and the ledger."""
    facts = [_facts(one) for one in study.observations(study.observed)]
    return sha256(json.dumps(facts).encode()).hexdigest()


def points_digest(seen: Interface) -> str:
    """Return a digest of an interface's points and cells."""
    return sha256(seen.points.tobytes() + seen.cells.tobytes()).hexdigest()


def _facts(seen: Observation) -> tuple[str, str, str]:
    noise = seen.noise
    stated = noise if isinstance(noise, PointErrors | UnknownErrors) else (type(noise).__qualname__, noise.facts)
    return seen.condition, points_digest(seen.interface), repr(stated)


def _same(one: object, other: object) -> bool:
    if one is other:
        return True
    try:
        return bool(one == other)
    except (TypeError, ValueError):
        return False


def results_at_hand(study: Study) -> dict[str, Any] | None:
    """Return the summary of the results in the folder if nothing that they depend on has changed, else None.

    They depend on study.yaml, the model, the observation with its noise, the outcomes of all runs, and on the versions
    of strandline and of the libraries that compute.
    """
    summary = read_json(study.folder / SUMMARY)
    try:
        study.runs.require_finished()
        now = facts_of(study, study.settings.seed) | {
            "observation_sha256": observation_digest(study),
            "ledger_sha256": outcome_digest(study.ledger_path, frozenset(study.runs.needed_keys)),
            "missing": {},
        }
    except (OSError, StrandlineError):
        return None
    names = (POSTERIOR, REPORT, FIGURES) if study.with_report else (POSTERIOR,)
    written = all((study.folder / name).exists() for name in names)
    if not written or any(summary.get(key) != value for key, value in now.items()):
        return None
    runs = summary["runs"]
    return summary | {"runs": runs | {"new": 0, "reused": runs["new"] + runs["reused"]}}


def facts_of(study: Study, seed: int) -> dict[str, Any]:
    """Return what results and answers say of the study, the program and the seed that they come from."""
    return {
        "study": study.name,
        "study_sha256": study.text_digest,
        "version": __version__,
        "versions": versions(),
        "model": study.runs.identity,
        "seed": seed,
    }


def named(one: object, *names: str) -> dict[str, Any]:
    """Return these attributes by name."""
    return {name: getattr(one, name) for name in names}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed packages that numbers depend on."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
