"""Active designs on a surrogate of the field: what is known, what to run next, and when to stop."""

from strandline.design.active.active_design import KINDS, ActiveDesign, Batch, Step
from strandline.design.active.campaign import ActiveRuns, BatchReport, Certificate, FieldOutcome, VarianceEffect
from strandline.design.active.chains import Normalised, sample_by_chains
from strandline.design.active.checking import BatchCheck
from strandline.design.active.choice import CRITERIA, Active, Criterion
from strandline.design.active.exact_draws import ExactDraws
from strandline.design.active.posterior_check import simulator_noise
from strandline.design.active.state import Knowledge, State, learn, posterior_state, training_of

__all__ = ["CRITERIA", "Active", "Criterion"]
