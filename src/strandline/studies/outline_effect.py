"""How much wider the posterior is because the undeformed outline comes from a picture."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from strandline.errors import InvalidInput, NumericsError
from strandline.interface import UnknownErrors
from strandline.posterior import Posterior
from strandline.runs import RunRecord
from strandline.studies.early_widths import predicted_at
from strandline.studies.expected_widths import expected_sd
from strandline.studies.study import Study

NEAREST = 8
"""Runs near the posterior that give the slopes, for each input and for the mean."""


def outline_effect(study: Study, records: Sequence[RunRecord], posterior: Posterior) -> dict[str, Any] | None:
    """Return the outline's errors, µm, and the expected sd of each input with and without them.

    Both widths are those of a model that is linear around the posterior's mean, with slopes from the runs near it.

    Args:
        study: The study.
        records: Its runs.
        posterior: Its posterior.

    Returns:
        The entry of summary.json; None if the outline comes from no picture. The widths are missing if the noise is
        inferred, or if too few runs succeeded.
    """
    found = study.undeformed
    if found is None:
        return None
    of: dict[str, Any] = {
        "sd_um": 1e3 * found.errors.sd,
        "length_um": 1e3 * found.errors.length,
        "offset_um": 1e3 * found.errors.offset,
    }
    names, noises = study.space.names, [*study.noises.values()]
    ok = [record for record in records if record.ok]
    if not ok or any(isinstance(one, UnknownErrors) for one in noises):
        return of
    x = np.array([[record.inputs[name] for name in names] for record in ok], float)
    away = (((x - posterior.mean) / posterior.sd) ** 2).sum(axis=1)
    dim = len(names)
    near = [ok[i] for i in np.argsort(away)[: NEAREST * (dim + 1)]]
    predicted = predicted_at(near, study.space, posterior.mean)
    if predicted is None:
        return of
    alone = replace(study, noises=found.noises)
    try:
        sds = [expected_sd(one, *predicted, study.observed) for one in (study, alone)]
    except (InvalidInput, NumericsError):
        return of
    return of | {
        name: dict(zip(names, (float(value) for value in one), strict=True))
        for name, one in zip(("expected_sd", "expected_sd_without"), sds, strict=True)
    }
