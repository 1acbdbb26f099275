"""Public helpers for tests: models with known posteriors, conformance suites."""
