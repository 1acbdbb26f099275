"""From a problem to its posterior: `calibrate` is the whole method on one screen.

In: a `Problem` (model, priors, observed interfaces with their errors) and `Settings`. Out: a `Calibration` (posterior,
surrogate, runs, misfit, what was doubtful). It knows no files, pictures or terminals.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.calibration.alternative import Alternative, Baseline, Kind, baseline, interim_posterior
    from strandline.calibration.coverage import CoverageFound, Replicate, repeatable, replicated
    from strandline.calibration.evidence import (
        ERRORS,
        SCALE,
        BayesFactor,
        Evidence,
        ModelComparison,
        averaged,
        log_evidence,
        require_odds,
    )
    from strandline.calibration.experiment import (
        CoordinateErrors,
        Errors,
        Experiment,
        Footprint,
        errors_behind,
        footprint,
    )
    from strandline.calibration.importance_sampler import (
        ENOUGH,
        FREEDOM,
        Densities,
        Pool,
        StudentMixture,
        effective_size,
        fitted,
        followed,
        importance_or_smc,
        only_inside,
        prior_and_posterior,
        prior_pool,
        tempered,
    )
    from strandline.calibration.learning import known_field
    from strandline.calibration.method import calibrate
    from strandline.calibration.misfit import (
        ConditionMisfit,
        Misfit,
        Prediction,
        Region,
        by_field,
        by_runs,
        unlikely_errors,
    )
    from strandline.calibration.problem import Calibration, Observer, Problem, Settings
    from strandline.calibration.progress import STAGES, observer_or_default, part_note, run_note, step_note
    from strandline.calibration.source import (
        TOLERATED,
        TOLERATED_SHARE,
        FieldQuality,
        Source,
        field_quality,
        posterior_source,
        prior_source,
    )
    from strandline.calibration.steps import steps_of
    from strandline.calibration.usual_alternatives import facts_of, prior_in_words, scaled_noise, with_prior
    from strandline.calibration.what_if import LEAST_RATIO, LEAST_SHIFT, Answer, reweight_or_resample, reweighted
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["Calibration", "Misfit", "Observer", "Problem", "Settings", "calibrate"]
