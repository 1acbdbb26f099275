"""Mutants that no test notices, and why none has to."""

__all__ = ["EXPLAINED", "EXPLAINED_ON_LINE"]

_OF_SIDES = (
    "((points - corners) * interface.normals[found.cells]).sum(axis=1)",
    "(((points - corners) * interface.normals[found.cells]).mean(axis=1))",
)
_OF_SHARES = (
    "(jnp.arange(number) + offset) / number * cumulative[-1]",
    "((jnp.arange(number) + offset) / number / cumulative[-1])",
)
_OF_SPREAD = (
    "simulated.points + width * np.linspace(-1.0, 1.0, number)[:, None, None]",
    "(simulated.points - width * np.linspace(-1.0, 1.0, number)[:, None, None])",
)
_OF_HALF = (
    "int(np.searchsorted(freedom, freedom[-1] / 2)) - 1",
    "(int(np.searchsorted(freedom, freedom[-1] / 2)))",
)
_OF_PAIRS = "len(a.cells) * len(b.cells)", "(len(a.cells))"
_OF_DISTANCE = "beyond ** 2 + off ** 2", "(beyond ** 2 - off ** 2)"
_OF_CYLINDERS = "above * above + beside * beside", "(above * above - beside * beside)"
_OF_NODES = "simulated.points - observed.points", "(observed.points - simulated.points)"
_OF_LAST = "len(cumulative) - 1", "(len(cumulative) + 1)"
_OF_ROWS = "len(observed.z) * (1 if observed.gradients is None else 1 + dim)", "(len(observed.z))"
_OF_KEYS = "jax.random.key_data(seed) if is_typed else seed", "(jax.random.key_data(seed))"
_OF_MIDDLES = (
    "observed.points.mean(axis=0) - run.points.mean(axis=0)",
    "(run.points.mean(axis=0) - observed.points.mean(axis=0))",
)
_OF_BOXES = (
    "np.maximum(low[k].take(boxes) - x, x - high[k].take(boxes))",
    "(np.minimum(low[k].take(boxes) - x, x - high[k].take(boxes)))",
)
_OF_PLACES = "np.cumsum(mass) - 0.5 * mass", "(np.cumsum(mass) + 0.5 * mass)"
_OF_SCALES = (
    "np.sqrt(np.mean(_rms(below - middle, weights, 1) ** 2))",
    "(np.mean(_rms(below - middle, weights, 1) ** 2))",
)
_OF_STEPS = "solved[:, 0, 0] - wider * solved[:, 0, 1]", "(solved[:, 0, 0] + wider * solved[:, 0, 1])"
_OF_BOTH = (
    "np.abs(step[:2]).max() < 0.0001 and abs(step[2]) < 1e-06",
    "(np.abs(step[:2]).max() < 0.0001 or abs(step[2]) < 1e-06)",
)
_OF_LEAST = "np.abs(step[:2]).max()", "(np.abs(step[:2]).min())"
EXPLAINED: dict[tuple[str, str, str], str] = {
    ("design/active/coverage_runs.py", "0", "(1)"): "Another scrambling of the Sobol points; either will do.",
    ("design/active/parabola.py", "np.maximum(values, 1e-12)", "(np.minimum(values, 1e-12))"): (
        "Scales the axes of the parabola, whose fit does not depend on it, unless inputs are exactly dependent."
    ),
    ("design/active/parabola.py", "1e-12", "(2e-12)"): "Only a floor that keeps the logarithm of a variance finite.",
    ("discrepancy/repeats.py", "one.lengths.sum()", "(one.lengths.mean())"): (
        "Takes another contour for the reference; they are compared only where all of them have points."
    ),
    ("discrepancy/comparison.py", "1", "(2)"): "Tells ratios of at least 10 from those of at most 1/10.",
    ("discrepancy/normal_offset.py", *_OF_SIDES): "Half or a third of a sum of which only the sign counts.",
    ("discrepancy/kernel_sums.py", "8", "(9)"): "Tiles of another size: the same sum, as fast or slower.",
    ("discrepancy/kernel_sums.py", "x[i] - y[i]", "(y[i] - x[i])"): "It is squared.",
    ("discrepancy/kernel_integrals.py", "200", "(201)"): "One more term of a series that has converged.",
    ("discrepancy/normal_offset.py", "True", "(False)"): "The first estimate from all points, not from some: slower.",
    ("discrepancy/many_distances.py", "some.mean(axis=0)", "(some.sum(axis=0))"): (
        "Other runs share a block: any do, but it takes longer."
    ),
    ("discrepancy/nearest.py", "0", "(1)"): "A tree of two leaves for few cells: the same cells are nearest.",
    ("discrepancy/nearest.py", "_cross(p, tangent) - across", "(across - _cross(p, tangent))"): "It is squared.",
    ("discrepancy/many_distances.py", "points.mean(axis=0)", "(points.sum(axis=0))"): (
        "Coordinates from another origin: only the rounding differs."
    ),
    ("likelihood/field.py", "measure = measure.tolerating(one.noise.scale, seen.interface)", "pass"): (
        "Takes a measure more exactly than the likelihood needs: slower."
    ),
    ("likelihood/inferred_noise.py", "LEVELS - 1e-09", "(LEVELS + 1e-09)"): (
        "Loses at most a last value whose weight is below the rounding of the others."
    ),
    ("likelihood/joint_errors.py", "True", "(False)"): "Only refuses lists of different lengths, which never come.",
    ("likelihood/local_likelihood.py", "True", "(False)"): "Only refuses lists of different lengths, which never come.",
    ("surrogate/field/warping.py", "True", "(False)"): "The same sum in another order, which takes longer.",
    ("likelihood/field.py", "log_density if is_on_host(log_density) else jax.jit(log_density)", "(log_density)"): (
        "The same function, not compiled."
    ),
    ("likelihood/noise_rule.py", "values[:dim] - values[dim:]", "(values[dim:] - values[:dim])"): (
        "All gradients change their sign; only their covariance counts."
    ),
    ("posterior/under_uncertainty.py", "0.5", "(1.0)"): "Levels of the other inputs, which are left out afterwards.",
    ("smc/moves.py", "positions - weights @ positions", "(weights @ positions - positions)"): (
        "Only products of two of them count."
    ),
    ("surrogate/field/mode_process.py", "0", "(1)"): "Fills rows that are not there.",
    ("smc/steps.py", *_OF_SHARES): "The last cumulative share is 1 to rounding.",
    ("surrogate/field/projection.py", "1e-12", "(2e-12)"): "Only holds parts without a rim, however weakly.",
    ("discrepancy/comparison.py", *_OF_MIDDLES): "Only its length counts.",
    ("discrepancy/measurement_lines.py", "np.abs(lines).max()", "(np.abs(lines).min())"): (
        "A margin for rounding, still far above it."
    ),
    ("discrepancy/normal_offset.py", "len(points) >= FEWEST", "(len(points) < FEWEST)"): (
        "Many interfaces one by one, few at once: the same sums by the other way."
    ),
    ("discrepancy/kernel_sums.py", "True", "(False)"): "Only refuses lists of different lengths.",
    ("discrepancy/many_currents.py", "-math.log10(share)", "(math.log10(share))"): (
        "Begins with the order that the bound requires: slower."
    ),
    ("discrepancy/many_distances.py", "True", "(False)"): "Only refuses lists of different lengths.",
    ("likelihood/interfaces.py", "True", "(False)"): "Only refuses lists of different lengths.",
    ("posterior/kde.py", "1e-12", "(2e-12)"): "No number of the cube is so near 0 or 1.",
    ("posterior/kde.py", "-weights", "(weights)"): "The same term for every bandwidth.",
    ("posterior/kde.py", "self.dim == 1 and close.any()", "(self.dim == 1)"): "A correction at no point.",
    ("posterior/kde.py", "len(points) > loo_points", "(len(points) <= loo_points)"): (
        "Many draws are all taken, few are drawn again: nearly the same bandwidth, but slower."
    ),
    ("posterior/netcdf.py", "np.clip(uniform, 1e-12, 1 - 1e-12)", "(uniform)"): "No number is so near 0 or 1.",
    ("smc/combined.py", "scouts - mean", "(mean - scouts)"): "Only its size counts.",
    ("surrogate/field/mode_process.py", "1e-300", "(2e-300)"): "Only a floor that keeps a ratio finite.",
    (
        "surrogate/field/projection.py",
        "centre[balls] - start[lines]",
        "(start[lines] - centre[balls])",
    ): "It is squared.",
    ("readers/shape.py", "cells.dimension(block.kind) or 0", "(cells.dimension(block.kind))"): (
        "Cells of an unknown kind are refused before."
    ),
    (
        "readers/vtk_xml.py",
        "np.split(connectivity, ends[:-1]) if len(ends) else []",
        "(np.split(connectivity, ends[:-1]))",
    ): ("Only called with cells."),
    ("runs/executors/slurm_batch.py", "False", "(True)"): "Only numbers are saved.",
    ("imaging/edge_checks.py", "1e-09", "(2e-09)"): "Only a floor that keeps a radius finite.",
    ("imaging/erf_step.py", "np.clip(wider / width, -0.5, 0.5)", "(wider / width)"): (
        "Other steps to the same minimum: a step that does not lower the sum is taken back."
    ),
    ("imaging/erf_step.py", "1e-09", "(2e-09)"): "Only a floor that keeps a quotient finite.",
    ("imaging/files/plain.py", "25", "(26)"): "Reads a byte more than it looks at.",
    ("imaging/half_level.py", "0.0", "(1.0)"): "The place where nothing was found, which is not used.",
    ("imaging/markov_path.py", "1e-06", "(2e-06)"): "Only a floor that keeps a quotient finite.",
    ("imaging/markov_path.py", "message.sum()", "(message.mean())"): "Messages are only known up to a factor.",
    ("imaging/surfaces/levels.py", "edges[1:] + edges[:-1]", "(edges[1:])"): "All centres half a bin farther on.",
    ("imaging/surfaces/levels.py", "(values.size / _EVERY) ** (1 / 2)", "(values.size / _EVERY)"): (
        "The noise is estimated from fewer voxels."
    ),
    ("imaging/surfaces/mesh.py", "1e-30", "(2e-30)"): "Only a floor that keeps a quotient finite.",
    ("imaging/template.py", "above[:-1] * above[1:]", "(above[:-1] / above[1:])"): "Only the sign counts.",
    ("studies/summary_field.py", "True", "(False)"): "Only refuses lists of different lengths.",
}
"""(file, before, after): the reason."""

EXPLAINED_ON_LINE: dict[tuple[str, str, str, str], str] = {
    ("studies/folder.py", "zip(starts, ends, strict=True)", "True", "(False)"): "Both have one entry a key.",
    ("studies/widths.py", "zip(study.space, sd, prior, strict=True)", "True", "(False)"): "One entry an input.",
    ("runs/executors/dask_driver.py", "while True:", "True", "(False)"): "Other news is heard at the next call.",
    ("design/active/active_design.py", "len(self._not_looked_at(x, 1)) > 0", "1", "(2)"): (
        "Only whether there are places to look at counts, not how many."
    ),
    ("design/active/sampling.py", "np.linspace(-1.0, 1.0, number)", *_OF_SPREAD): (
        "The same interfaces in reverse order."
    ),
    ("design/active/parabola.py", "part = max(int(np.searchsorted(freedom,", *_OF_HALF): (
        "One more draw among those that count most."
    ),
    ("discrepancy/repeats.py", "half = max(len(path) // (2 * PIECES), 2)", "2", "(3)"): (
        "The reference outline is smoothed over a somewhat different window."
    ),
    ("discrepancy/normal_offset.py", "if found is None:", "found is None", "(False)"): (
        "Then the interfaces are compared one by one: slower."
    ),
    ("discrepancy/kernel_integrals.py", "reach = math.inf if", *_OF_PAIRS): (
        "Pairs that together count for less than 1e-12 are left out of more or of fewer sums."
    ),
    ("discrepancy/kernel_integrals.py", "log_bound = math.log(4)", "4", "(5)"): (
        "A bound that is a quarter larger: at most one more point of the rule."
    ),
    ("discrepancy/kernel_integrals.py", "near = beyond**2 + off**2", *_OF_DISTANCE): (
        "Pairs are kept that are too far apart to count: slower."
    ),
    ("discrepancy/nearest.py", "size = max(1, BLOCK // len(target.cells))", "1", "(2)"): (
        "Blocks of another size: the same result."
    ),
    ("discrepancy/nearest.py", "above * above + beside * beside", *_OF_CYLINDERS): (
        "A lower bound of the distance, which is lower still: more boxes are tried."
    ),
    (
        "discrepancy/nearest.py",
        "_SLACK * (1 + size)",
        "1",
        "(2)",
    ): "More room for rounding: more segments are tried.",
    ("discrepancy/nearest.py", "np.where(lengths > 0, lengths, 1.0)", "1.0", "(2.0)"): ("Divides a vector of zeros."),
    ("discrepancy/tracked_points.py", "(simulated.points - observed.points) ** 2", *_OF_NODES): "It is squared.",
    ("likelihood/inferred_noise.py", "log_density[1:] -= np.log(max(len(log_density) - 1, 1))", "1", "(2)"): (
        "There is no error of the model to compare, or there are many."
    ),
    ("posterior/kde.py", "np.searchsorted(cumulative, cube[:, 0] * cumulative[-1])", *_OF_LAST): (
        "No number of the cube is 1, so the last draw is never passed."
    ),
    ("posterior/kde.py", "normal_rule = (_size(mass) *", "unit.shape[0] + 2", "(unit.shape[0])"): (
        "Only the ends of the search for the bandwidth, a tenth and three times this rule, up to a quarter larger then."
    ),
    ("posterior/netcdf.py", "np.clip(uniform, 1e-12, 1 - 1e-12)", "1 - 1e-12", "(1)"): (
        "Keeps out a number of exactly 1, which does not come."
    ),
    ("posterior/posterior.py", "words = jax.random.key_data(seed)", *_OF_KEYS): (
        "The data of a key that is an array are this array."
    ),
    ("posterior/quadrature.py", "wanted = int(np.searchsorted(-remainder, -_LEFT_ALONE)) + 1", "1", "(2)"): (
        "One more cell is refined."
    ),
    ("surrogate/field/correction.py", "best = int(np.argmin([np.sum(one**2) for one in errors]))", "2", "(3)"): (
        "Left-out errors are compared by their cubes: the order changes in close cases only."
    ),
    ("surrogate/field/mode_process.py", "rows = len(observed.z) *", *_OF_ROWS): "More starts are tried: slower.",
    ("posterior/rank_tests.py", "np.random.default_rng(0)", "0", "(1)"): "Other random numbers; any will do.",
    ("discrepancy/measurement_lines.py", "beyond(-side, 0.0)", "0.0", "(1.0)"): "More segments are tried: slower.",
    ("discrepancy/kernel_integrals.py", "reach = width * math.sqrt(2", "1.0", "(2.0)"): (
        "Pairs are kept that are too far apart to count: slower."
    ),
    ("discrepancy/kernel_sums.py", "length = max(1 <<", "1", "(2)"): "More padding: slower.",
    ("discrepancy/normal_offset.py", "(around - middle) @ normal", "around - middle", "(around)"): (
        "Of the parabola only the bend counts, which no shift changes."
    ),
    ("discrepancy/nearest.py", "self.rounding = _SLACK[1]", "0.0", "(1.0)"): "A larger margin for rounding.",
    ("discrepancy/nearest.py", "apart = np.maximum(np.maximum(low[k]", *_OF_BOXES): (
        "A lower bound of the distance, which is lower still: more boxes are tried."
    ),
    ("likelihood/inferred_noise.py", "else 0.1) * rms, 4 * rms", "4", "(5)"): "The grid ends where nothing is left.",
    ("likelihood/inferred_noise.py", "place = np.minimum((np.cumsum(mass)", *_OF_PLACES): (
        "Levels that begin one value of the grid earlier."
    ),
    ("likelihood/interfaces.py", "Counter(self.conditions).most_common(1)", "1", "(2)"): "The first one is taken.",
    (
        "likelihood/linearised_residuals.py",
        "if model.shared.any() else 0",
        "0",
        "(1)",
    ): "Without shared errors they stay 0.",
    ("likelihood/linearised_residuals.py", "away = np.where(apart", "1.0", "(2.0)"): "Divides what is replaced then.",
    ("likelihood/linearised_residuals.py", "t *= np.where((t * chord)", "1.0", "(2.0)"): (
        "Only where the closest point is a corner that bends by more than a right angle."
    ),
    (
        "surrogate/field/correction.py",
        "scale = max(float(np.sqrt(",
        *_OF_SCALES,
    ): "A scale of the kernel, which cancels.",
    ("surrogate/field/correction.py", "scale = max(float(np.sqrt(", "below - middle", "(below + middle)"): (
        "A scale of the kernel, which cancels."
    ),
    ("surrogate/field/projection.py", "np.roll(cells, -1, axis=1)", "-1", "(1)"): "The same sides, sorted then.",
    ("surrogate/field/projection.py", "np.roll(cells, -1, axis=1)", "1", "(2)"): "The same sides, sorted then.",
    ("runs/ledger_schema.py", "uri=True, isolation_level=None", "True", "(False)"): "SQLite may take addresses anyway.",
    ("runs/ledger_schema.py", "uri=True, isolation_level=None", "30.0", "(60.0)"): "Waits longer.",
    ("runs/ledger_schema.py", 'if os.name == "posix"', "os.name == 'posix'", "(os.name != 'posix')"): (
        "Only shows if the power fails."
    ),
    ("imaging/course.py", "far = bound > 0", "0", "(1)"): "Crossed normals are sought from one pixel farther out.",
    ("imaging/edge.py", "(-ASIDE, 0.0, ASIDE)", "0.0", "(1.0)"): "Looks at the place one pixel beside.",
    (
        "imaging/edge.py",
        "found.sum() < FEWEST // 3",
        "3",
        "(4)",
    ): "A quarter of the normals is enough for another pass.",
    ("imaging/erf_step.py", "trial = np.clip(places +", "1.0", "(2.0)"): (
        "Other steps to the same minimum: a step that does not lower the sum is taken back."
    ),
    ("imaging/erf_step.py", "return solved[:, 0, 0] - wider", *_OF_STEPS): (
        "Other steps to the same minimum: a step that does not lower the sum is taken back."
    ),
    ("imaging/registration.py", "grid = np.zeros(2 * np.array", "2", "(3)"): "More zeros around.",
    ("imaging/registration.py", "if np.abs(step[:2]).max() < 1e-4", *_OF_BOTH): "Ends a step earlier or later.",
    ("imaging/registration.py", "if np.abs(step[:2]).max() < 1e-4", *_OF_LEAST): "Ends a step earlier or later.",
    ("imaging/surfaces/surface_errors.py", "np.maximum(known, 1)", "1", "(2)"): "Differs at lags with a single pair.",
    ("studies/observed.py", "close = get_close_matches", "1", "(2)"): "Only the first is named.",
    ("studies/pictures/photographed.py", 'source="nothing yet"', "1.0", "(2.0)"): "A size that is not used.",
    (
        "runs/ledger_schema.py",
        "partial.unlink(missing_ok=True)",
        "True",
        "(False)",
    ): "Only where a disk has no hard links.",
    ("runs/executors/local.py", "shutil.rmtree(folder, ignore_errors=True)", "True", "(False)"): (
        "Only if a scratch folder cannot be removed."
    ),
}
"""(file, part of the line, before, after): the reason, of changes that would need another one elsewhere in the file."""
