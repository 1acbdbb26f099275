"""Active designs on a surrogate of the field: what is known, what to run next, and when to stop."""

from strandline.active.campaign import ActiveRuns
from strandline.active.choice import CRITERIA
from strandline.active.cost import SLOW_BATCH, seconds_of_a_batch
from strandline.active.design import Active, ActiveDesign, Batch, CheckResult, Step
from strandline.active.outcome import Certificate, FieldOutcome, VarianceEffect
from strandline.active.reported import BatchReport
from strandline.active.state import Knowledge, State, learn, posterior_state

__all__ = [
    "CRITERIA",
    "SLOW_BATCH",
    "Active",
    "ActiveDesign",
    "ActiveRuns",
    "Batch",
    "BatchReport",
    "Certificate",
    "CheckResult",
    "FieldOutcome",
    "Knowledge",
    "State",
    "Step",
    "VarianceEffect",
    "learn",
    "posterior_state",
    "seconds_of_a_batch",
]
