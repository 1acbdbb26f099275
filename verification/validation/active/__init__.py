"""Active designs on a surrogate of the field, against the true model."""
