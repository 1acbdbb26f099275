"""Studies of the biofilm with 1 µm of white noise: with the likelihood of these errors, and with the study's σ_N².

True inputs are drawn from the prior, and observations with this noise are analysed in both ways. A surrogate of the
interface stands for the simulator in both, also where it errs by more than this noise hides. Needs the finished runs of
the studies.

With `--planted`, mistakes are planted in the analysis too: the ranks must then leave their band. `--published` is the
number of replicates with the study's σ_N², which cost more.

    python -m verification.validation.own_likelihood [--replicates 200] [--published 100] [--planted 60] FOLDER ...
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from verification.validation.tables import arguments, show, table

from strandline.calibration.coverage import CoverageFound, repeatable, replicated
from strandline.calibration.experiment import Experiment, field_quality, prior_source
from strandline.calibration.learning import known_field
from strandline.design.run_filter import RunFilter
from strandline.discrepancy import NormalOffset
from strandline.foundations import one_thread, use_double
from strandline.interface import GaussianNoise, PointErrors
from strandline.questions.knowledge import runs_to_learn_from
from strandline.studies import Study, load_study
from strandline.studies.foresight.first_run import observations_of

ERRORS = PointErrors(0.001)
TOGETHER = PointErrors(0.001, shift=0.005, offset=0.002)
"""Errors with a part that all points share, which a planted mistake drops."""


def analysed(experiment: Experiment, noise: Any, **changes: Any) -> Experiment:
    """Return the experiment analysed with another noise in all conditions."""
    return replace(experiment, noises=dict.fromkeys(experiment.noises, noise), **changes)


def with_mistakes(experiment: Experiment) -> dict[str, Experiment]:
    """Return the experiment with each planted mistake in its analysis."""
    return {
        "planted: σ² given for σ": analysed(experiment, PointErrors(ERRORS.sd**2)),
        "planted: ½ forgotten": analysed(experiment, GaussianNoise(0.5 * ERRORS.sd**2)),
        "planted: Λ dropped": replace(experiment, errors=dict.fromkeys(experiment.errors, TOGETHER)),
    }


def rows(study: Study, replicates: int, published: int, planted: int) -> Iterator[tuple]:
    """Yield a row for each input with the noise's likelihood, the study's own, and planted mistakes."""
    (name, measure), noise = next(iter(study.discrepancies.items())), study.noise
    own = replace(study, noise=ERRORS, discrepancies={"normal_offset": NormalOffset()})
    judge = RunFilter(own.observations(observations_of(study)), own.discrepancies, study.settings.failures)
    records = runs_to_learn_from(study)
    points = np.array([[record.inputs[name] for name in study.space.names] for record in records], float)
    with one_thread():
        knowledge = known_field(points, records, judge, study.space)[0]
        source = prior_source(knowledge, study.space)
        quality = field_quality(source)
        print(f"{study.name}: the surrogate errs by {1e3 * quality.median:.2g} µm", flush=True)
        experiment = repeatable(source)
        analyses = {
            "normal_offset, s = 1 µm": (experiment, replicates),
            f"{name}, study's σ_N²": (analysed(experiment, noise, measure=measure), published),
        }
        if planted:
            analyses |= {label: (one, planted) for label, one in with_mistakes(experiment).items()}
        for label, (one, number) in analyses.items():
            begun = perf_counter()
            replicates_of_it = tuple(replicated(one, source, seed=3, number=k) for k in range(number))
            found = CoverageFound(study.space.names, replicates_of_it)
            seconds = perf_counter() - begun
            fits = "yes" if found.fit_band.inside else "no"
            of_all = 100 * float(found.regions[-1].found[0]), fits, seconds / number
            for i, parameter in enumerate(study.space):
                cover = [100 * interval.found[i] for interval in found.intervals]
                ranks = "yes" if found.bands[i].inside else "no"
                of_input = float(found.sd[i]), float(found.of_limit[i]), *cover, float(found.z[:, i].std()), ranks
                yield study.name, label, number, parameter.name, *of_input, *of_all


HEADING = (
    "study | likelihood | observations {d} | input | mean sd {.3g} | sd / limit {.2f} | 50 % cover {.0f} "
    "| 90 % cover {.0f} | sd of z {.2f} | ranks in band | 90 % region {.0f} | ranks of log L in band | s each {.2f}"
)


if __name__ == "__main__":
    options = arguments(__doc__, words="FOLDER", replicates=200, published=100, planted=0)
    use_double()
    numbers = options.replicates, options.published, options.planted
    found = (row for folder in options.words for row in rows(load_study(Path(folder)), *numbers))
    show([table("own_likelihood", "1 µm of white noise", HEADING, found, live=True)])
