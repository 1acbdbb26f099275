"""Which runs to make: points that fill the box, refinement where the posterior lies, active designs.

In: the space of inputs, the observation, and the runs so far. Out: the next inputs, or that no more are needed.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.design.active import (
        KINDS,
        Active,
        ActiveRuns,
        BatchCheck,
        BatchReport,
        Certificate,
        Criterion,
        ExactDraws,
        FieldOutcome,
        Knowledge,
        Normalised,
        State,
        Step,
        VarianceEffect,
        learn,
        sample_by_chains,
        simulator_noise,
        training_of,
    )
    from strandline.design.active.choice import LARGEST_BATCH
    from strandline.design.active.fidelities import Fidelities, FidelityReport, as_by_model
    from strandline.design.active.informed_design import SETTLING, first_inputs
    from strandline.design.active.state import DRAFT_PARTICLES
    from strandline.design.candidates import FEWEST_POINTS, WHOLE, Candidate, Look, Setting, key_of
    from strandline.design.refinement import SAMPLING, Learnt, Refinement, Round, over_prior, refine, shifts, sobol
    from strandline.design.run_filter import RunFilter, SetAside, says_whether_runs_succeed
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["sobol"]
