"""From a problem to its posterior: `calibrate` is the whole method on one screen.

In: a `Problem` (model, priors, observed interfaces with their errors) and `Settings`. Out: a `Calibration` (posterior,
surrogate, runs, misfit, what was doubtful). It knows no files, pictures or terminals.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.calibration.best_fit import Prediction, by_field, by_runs
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
        TOLERATED,
        TOLERATED_SHARE,
        CoordinateErrors,
        Errors,
        Experiment,
        FieldQuality,
        Footprint,
        Source,
        errors_behind,
        field_quality,
        footprint,
        posterior_source,
        prior_source,
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
    from strandline.calibration.learning import known_field, steps_of
    from strandline.calibration.method import calibrate
    from strandline.calibration.misfit import ConditionMisfit, Misfit, Region, unlikely_errors
    from strandline.calibration.problem import (
        STAGES,
        Calibration,
        Observer,
        Problem,
        Settings,
        observer_or_default,
        part_note,
        require_learnable,
        run_note,
        step_note,
    )
    from strandline.calibration.usual_alternatives import facts_of, prior_in_words, scaled_noise, with_prior
    from strandline.calibration.what_if import (
        LEAST_RATIO,
        LEAST_SHIFT,
        Alternative,
        AlternativePosterior,
        Baseline,
        Kind,
        baseline,
        interim_posterior,
        reweight_or_resample,
        reweighted,
    )
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["Calibration", "Misfit", "Observer", "Problem", "Settings", "calibrate"]
