"""Active designs on a surrogate of the field, compared with the true model."""
