"""A surrogate of the interface as a field: modes of its displacement, and a Gaussian process for each."""

from strandline.surrogate.field.field import FieldPrediction, FieldSurrogate, FieldTraining, fit_field
from strandline.surrogate.field.warping import fewest_runs
