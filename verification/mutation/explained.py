"""Mutants that no test notices, and why none has to."""

__all__ = ["EXPLAINED"]

EXPLAINED: dict[tuple[str, str, str], str] = {
    ("design/active/elsewhere.py", "0", "(1)"): "Another scrambling of the Sobol points; either will do.",
    ("design/active/parabola.py", "np.maximum(values, 1e-12)", "(np.minimum(values, 1e-12))"): (
        "Scales the axes of the parabola, whose fit does not depend on it, unless inputs are exactly dependent."
    ),
    ("design/active/parabola.py", "1e-12", "(2e-12)"): "Only a floor that keeps the logarithm of a variance finite.",
}
"""(file, before, after): the reason."""
