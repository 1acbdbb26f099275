"""Mutants that no test notices, and why none has to."""

__all__ = ["EXPLAINED"]

_OF_SIDES = (
    "((points - corners) * interface.normals[found.cells]).sum(axis=1)",
    "(((points - corners) * interface.normals[found.cells]).mean(axis=1))",
)
_OF_SHARES = (
    "(jnp.arange(number) + offset) / number * cumulative[-1]",
    "((jnp.arange(number) + offset) / number / cumulative[-1])",
)
EXPLAINED: dict[tuple[str, str, str], str] = {
    ("design/active/elsewhere.py", "0", "(1)"): "Another scrambling of the Sobol points; either will do.",
    ("design/active/parabola.py", "np.maximum(values, 1e-12)", "(np.minimum(values, 1e-12))"): (
        "Scales the axes of the parabola, whose fit does not depend on it, unless inputs are exactly dependent."
    ),
    ("design/active/parabola.py", "1e-12", "(2e-12)"): "Only a floor that keeps the logarithm of a variance finite.",
    ("discrepancy/contours/repeats.py", "one.lengths.sum()", "(one.lengths.mean())"): (
        "Takes another contour for the reference; they are compared only where all of them have points."
    ),
    ("discrepancy/extents.py", "1", "(2)"): "Tells ratios of at least 10 from those of at most 1/10.",
    ("discrepancy/normal_offset.py", *_OF_SIDES): "Half or a third of a sum of which only the sign counts.",
    ("discrepancy/products/kernel_sums.py", "8", "(9)"): "Tiles of another size: the same sum, as fast or slower.",
    ("discrepancy/products/kernel_sums.py", "x[i] - y[i]", "(y[i] - x[i])"): "It is squared.",
    ("discrepancy/products/surface_integrals.py", "200", "(201)"): "One more term of a series that has converged.",
    ("discrepancy/registration.py", "True", "(False)"): "The first estimate from all points, not from some: slower.",
    ("discrepancy/search/blocks.py", "some.mean(axis=0)", "(some.sum(axis=0))"): (
        "Other runs share a block: any do, but it takes longer."
    ),
    ("discrepancy/search/nearest.py", "0", "(1)"): "A tree of two leaves for few cells: the same cells are nearest.",
    ("discrepancy/search/sieve.py", "_cross(p, tangent) - across", "(across - _cross(p, tangent))"): "It is squared.",
    ("discrepancy/search/signed_sums.py", "points.mean(axis=0)", "(points.sum(axis=0))"): (
        "Coordinates from another origin: only the rounding differs."
    ),
    ("likelihood/field.py", "measure = measure.tolerating(one.noise.scale, seen.interface)", "pass"): (
        "Takes a measure more exactly than the likelihood needs: slower."
    ),
    ("likelihood/inferred_noise.py", "LEVELS - 1e-09", "(LEVELS + 1e-09)"): (
        "Loses at most a last value whose weight is below the rounding of the others."
    ),
    ("likelihood/joint_errors.py", "True", "(False)"): "Only refuses lists of different lengths, which never come.",
    ("likelihood/nearby.py", "True", "(False)"): "Only refuses lists of different lengths, which never come.",
    ("surrogate/field/modes.py", "True", "(False)"): "The same sum in another order, which takes longer.",
    ("likelihood/learnt.py", "log_density if is_on_host(log_density) else jax.jit(log_density)", "(log_density)"): (
        "The same function, not compiled."
    ),
    ("likelihood/noise_rule.py", "values[:dim] - values[dim:]", "(values[dim:] - values[:dim])"): (
        "All gradients change their sign; only their covariance counts."
    ),
    ("posterior/under_uncertainty.py", "0.5", "(1.0)"): "Levels of the other inputs, which are left out afterwards.",
    ("smc/moves.py", "positions - weights @ positions", "(weights @ positions - positions)"): (
        "Only products of two of them count."
    ),
    ("surrogate/field/derivative_kernel.py", "0", "(1)"): "Fills rows that are not there.",
    ("smc/resampling.py", *_OF_SHARES): "The last cumulative share is 1 to rounding.",
    ("surrogate/field/projection.py", "1e-12", "(2e-12)"): "Only holds parts without a rim, however weakly.",
}
"""(file, before, after): the reason."""
