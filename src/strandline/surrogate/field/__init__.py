"""A surrogate of the interface as a field: modes of its displacement, and a Gaussian process for each."""

from strandline.surrogate.field.field import (
    MANY_INPUTS,
    FieldPrediction,
    FieldSurrogate,
    FieldTraining,
    fewest_runs,
    fit_field,
)
