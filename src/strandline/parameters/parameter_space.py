"""Parameters with names, units, priors and a design box; the map between the unit cube and physical values."""

import html
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr, ndtri

from strandline.foundations import (
    figure_text,
    html_table,
    html_text,
    is_finite,
    require,
    require_label,
    require_name,
    unfit,
    unit_text,
)
from strandline.parameters.priors import EDGE, Prior, Truncated, normal_score, require_span, truncate

RESERVED: tuple[str, ...] = ("weight", "log_weight", "log_likelihood", "log_prior", "particle", "chain", "draw")
RESERVED += ("nuisance_value", "nuisance_input", "value_index", "nuisance_values", "conditional_log_evidence")
"""Names of variables and dimensions in the files of a posterior; no input may have one of them."""
PRIOR_POINTS = 1000
"""Quantiles from which the standard deviation of a prior is computed."""
LEAST_EIGENVALUE = 1e-8  # of a correlation; below it, rounding shows in its inverse


@dataclass(frozen=True)
class Parameter:
    """One uncertain input.

    Args:
        name: name of the input in the simulator; see `strandline.foundations.require_name`.
        prior: the distribution before the data are seen.
        unit: e.g. ``Pa``; ``1`` for a pure number.
        box: interval in which forward runs are made; default: the support of the prior.
        nuisance: whether the input is uncertain but not calibrated (θ in the paper); results are averaged over it.
        symbol: symbol in figures, report and tables, e.g. ``ν`` or ``V̇_in``; default: the name.
        of_field: the `RandomField` that this input is a coefficient of; None for an input that is shown by itself.

    A prior that extends beyond the box is truncated to it, because nothing is known about the simulator outside the
    box; `mass_cut` is the probability cut off.

    Raises:
        InvalidInput: the name or the unit cannot be stored in results, or the prior or the box is invalid.
    """

    name: str
    prior: Prior
    unit: str = "1"
    box: tuple[float, float] | None = None
    nuisance: bool = False
    symbol: str = ""
    of_field: Any = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_name("name of an input", self.name, reserved=RESERVED)
        require_label(f"unit of {self.name}", self.unit)
        given: object = self.prior
        if not isinstance(given, Prior):
            expected, remedy = "a distribution, such as Uniform", "A known value goes into `fixed` of the Problem."
            raise unfit(f"prior of {self.name}", given, expected, remedy)
        low, high = self.interval
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            correct = "Exchange the bounds." if low > high else "Correct the box."
            remedy = correct if self.box else f"Give {self.name} a box: [low, high]; its prior has no bounds."
            raise unfit(f"design box of {self.name}", [low, high], "two finite numbers, the lower one first", remedy)
        require_span(f"design box of {self.name}", low, high)
        _ = self.truncated_prior

    @property
    def interval(self) -> tuple[float, float]:
        """The design box, (low, high)."""
        return self.prior.support if self.box is None else self.box

    @property
    def truncated_prior(self) -> Prior:
        """The prior that is used: `prior`, restricted to the design box."""
        return truncate(self.prior, *self.interval)

    @property
    def mass_cut(self) -> float:
        """Prior probability outside the design box."""
        prior = self.truncated_prior
        return prior.mass_cut if isinstance(prior, Truncated) else 0.0

    def label(self) -> str:
        """Return name and unit as plain text: ``E [Pa]``, ``nu``."""
        return self.name if self.unit in ("", "1") else f"{self.name} [{self.unit}]"

    @property
    def shown(self) -> str:
        """The symbol, or the name if there is no symbol."""
        return self.symbol or self.name

    def figure_label(self) -> str:
        """Return symbol and typeset unit for an axis of a figure."""
        symbol = figure_text(self.symbol) if self.symbol else self.name.replace("$", r"\$")
        unit = unit_text(self.unit).replace("$", r"\$")
        return f"{symbol} [{unit}]" if unit else symbol


@dataclass(frozen=True)
class ParameterSpace:
    """The inputs of a calibration, in a fixed order.

    Args:
        parameters: The inputs.
        correlation: Correlation of pairs of inputs, ``{("E", "nu"): 0.6}``, others being independent: that of the
            standard normal quantiles of their priors (a Gaussian copula), which stay as they are.

    Raises:
        InvalidInput: No inputs, or two of one name; no input to calibrate; a correlation of no two inputs, or out of
            (-1, 1), or of a nuisance input with a calibrated one; correlations that contradict each other.
    """

    parameters: tuple[Parameter, ...]
    correlation: Mapping[tuple[str, str], float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        given: object = self.parameters
        if not (isinstance(given, tuple | list) and all(isinstance(one, Parameter) for one in given)):
            raise unfit("inputs", given, "a tuple of Parameters, e.g. (Parameter(…),)")
        names = self.names
        if not names or len(set(names)) != len(names):
            remedy = "Rename or add inputs."
            raise unfit("names of the inputs", list(names), "at least one input, all names different", remedy)
        if not self.calibrated:
            found = f"none: {', '.join(names)} {'is' if len(names) == 1 else 'are all'} nuisance"
            remedy = "Remove `nuisance` from the inputs to calibrate."
            raise unfit("inputs to calibrate", found, "at least one input that is not nuisance", remedy)
        if self.correlation:
            self._require_correlation()

    def __repr__(self) -> str:
        correlated = f", correlation={dict(self.correlation)}" if self.correlation else ""
        return f"ParameterSpace(parameters={self.parameters!r}{correlated})"

    def _require_correlation(self) -> None:
        seen = set[frozenset[str]]()
        for pair, value in self.correlation.items():
            names, both = " and ".join(map(str, pair)), frozenset(pair)
            what = f"correlation of {names}"
            right = len(both) == 2 and both <= {*self.names} and both not in seen
            require(right, what, names, f"two of the inputs {', '.join(self.names)}, once", "Correct the names.")
            require(is_finite(value) and -1 < value < 1, what, value, "a number above -1 and below 1", "Correct it.")
            nuisance = {self[name].nuisance for name in pair}
            expected = "both nuisance or both calibrated: the cut reading takes them as independent"
            require(len(nuisance) == 1, what, "one of them is nuisance", expected, "Remove it, or `nuisance`.")
            seen.add(both)
        least = float(np.linalg.eigvalsh(self._normal_correlation)[0])
        expected, found = "a positive definite matrix", f"a matrix with the eigenvalue {least:.3g}"
        require(least > LEAST_EIGENVALUE, "correlation of the inputs", found, expected, "Lower some of them.")

    @cached_property
    def _normal_correlation(self) -> Float[np.ndarray, "dim dim"]:
        R = np.eye(self.dim)
        for pair, value in self.correlation.items():
            i, j = (self.names.index(name) for name in pair)
            R[i, j] = R[j, i] = value
        return R

    @cached_property
    def root(self) -> Float[np.ndarray, "dim dim"]:
        """Lower root L of the correlation: of independent standard normal z, L z are the normal quantiles of inputs."""
        return np.linalg.cholesky(self._normal_correlation)

    @cached_property
    def _excess(self) -> Float[np.ndarray, "dim dim"]:
        """What the correlation adds to the precision of the normal quantiles."""
        return np.linalg.inv(self._normal_correlation) - np.eye(self.dim)

    def subspace(self, columns: Iterable[int]) -> "ParameterSpace":
        """Return some of the inputs, with the correlations among them.

        Raises:
            InvalidInput: One of them is correlated with another input, on whose value its prior depends.
        """
        kept = tuple(self.parameters[i] for i in columns)
        names = {one.name for one in kept}
        for pair in self.correlation:
            inside = len(names & {*pair})
            what, found = f"correlation of {pair[0]} and {pair[1]}", "one of the two is known"
            require(inside != 1, what, found, "both known, or none", "Leave it out, or the known value.")
        return ParameterSpace(kept, {pair: value for pair, value in self.correlation.items() if names >= {*pair}})

    def _repr_html_(self) -> str:
        columns = ((p.name, unit_text(p.unit), repr(p.prior), "yes" if p.nuisance else "") for p in self)
        rows = [(html_text(name), *map(html.escape, others)) for name, *others in columns if name in self.scalars]
        of_fields = ((one.name, unit_text(one.unit), repr(one.prior), "") for one in self.fields)
        rows += [tuple(map(html.escape, row)) for row in of_fields]
        return html_table(("input", "unit", "prior", "nuisance"), rows)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        if name not in self.names:
            raise unfit("name of an input", name, f"one of {', '.join(self.names)}", "Correct the name.")
        return self.parameters[self.names.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(p.name for p in self.parameters)

    @property
    def scalars(self) -> tuple[str, ...]:
        """Names of the inputs that are no coefficients of a field, in order: those that tables and figures show."""
        return tuple(p.name for p in self.parameters if p.of_field is None)

    @property
    def fields(self) -> tuple[Any, ...]:
        """The random fields, each a `RandomField`, all of whose inputs are among these."""
        found = dict.fromkeys(p.of_field for p in self.parameters if p.of_field is not None)
        return tuple(one for one in found if set(one.names) <= set(self.names))

    @property
    def shown(self) -> tuple[str, ...]:
        """Names that a text lists: those of `scalars` and of `fields`."""
        return (*self.scalars, *(one.name for one in self.fields))

    @property
    def calibrated(self) -> tuple[int, ...]:
        """Columns of the calibrated inputs, x in the paper."""
        return tuple(i for i, p in enumerate(self.parameters) if not p.nuisance)

    @property
    def nuisance(self) -> tuple[int, ...]:
        """Columns of the nuisance inputs, θ in the paper."""
        return tuple(i for i, p in enumerate(self.parameters) if p.nuisance)

    @property
    def calibrated_space(self) -> "ParameterSpace":
        """The calibrated inputs only, in order."""
        return self.subspace(self.calibrated)

    @property
    def dim(self) -> int:
        """Number of inputs."""
        return len(self.parameters)

    @property
    def low(self) -> Float[np.ndarray, " dim"]:
        """Lower corner of the design box, physical."""
        return np.array([p.interval[0] for p in self.parameters], float)

    @property
    def high(self) -> Float[np.ndarray, " dim"]:
        """Upper corner of the design box, physical."""
        return np.array([p.interval[1] for p in self.parameters], float)

    @cached_property
    def prior_sd(self) -> Float[np.ndarray, " dim"]:
        """Standard deviations of the truncated priors, physical, from their quantiles."""
        return np.asarray(self.marginal_quantiles((np.arange(PRIOR_POINTS) + 0.5) / PRIOR_POINTS).std(axis=0))

    def to_physical(self, u: Float[np.ndarray, "*run dim"]) -> Float[np.ndarray, "*run dim"]:
        """Map the unit cube linearly onto the design box."""
        return np.asarray(self.low + u * (self.high - self.low))

    def to_unit(self, x: Float[np.ndarray, "*run dim"]) -> Float[np.ndarray, "*run dim"]:
        """Map the design box linearly onto the unit cube."""
        return np.asarray((x - self.low) / (self.high - self.low))

    def log_prior(self, x: Any) -> Any:
        """Return the joint log prior of physical points (…, dim) → (…); NumPy or JAX."""
        found: Any = sum(p.truncated_prior.log_density(x[..., i]) for i, p in enumerate(self.parameters))
        if not self.correlation:
            return found
        z = {i: normal_score(self.parameters[i].truncated_prior, x[..., i]) for i in self._correlated}
        square = sum(self._excess[i, j] * z[i] * z[j] for i in z for j in z)
        return found - 0.5 * square - np.log(np.diag(self.root)).sum()

    @cached_property
    def _correlated(self) -> tuple[int, ...]:
        return tuple(i for i, name in enumerate(self.names) if any(name in pair for pair in self.correlation))

    def inside(self, x: Float[np.ndarray, "point dim"]) -> Bool[np.ndarray, " point"]:
        """Return which points lie in the design box and have a prior density above 0."""
        out = np.asarray(((x >= self.low) & (x <= self.high)).all(axis=1))
        out[out] = np.isfinite(np.asarray(self.log_prior(x[out])))
        return out

    def prior_quantiles(self, p: Float[np.ndarray, "particle dim"]) -> Float[np.ndarray, "particle dim"]:
        """Map independent uniform numbers to draws from the prior, through its quantile functions."""
        p = np.array(p, float)
        if self.correlation:
            some = list(self._correlated)
            z = ndtri(np.clip(p[:, some], EDGE, 1 - EDGE))
            p[:, some] = ndtr(z @ self.root[np.ix_(some, some)].T)
        columns = [q.truncated_prior.quantile(p[:, i]) for i, q in enumerate(self.parameters)]
        return np.stack([np.asarray(c, float) for c in columns], axis=1)

    def prior_shares(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point dim"]:
        """Return the inverse of `prior_quantiles`: of independent inputs, the share of each prior below a point."""
        shares = self.marginal_shares(x)
        if self.correlation:
            some = list(self._correlated)
            z = ndtri(np.clip(shares[:, some], EDGE, 1 - EDGE))
            shares[:, some] = ndtr(np.linalg.solve(self.root[np.ix_(some, some)], z.T).T)
        return shares

    def marginal_quantiles(self, p: Float[np.ndarray, " level"]) -> Float[np.ndarray, "level dim"]:
        """Return the quantiles of each input's prior, whatever it is correlated with."""
        return np.stack([np.asarray(q.truncated_prior.quantile(p), float) for q in self.parameters], axis=1)

    def marginal_shares(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point dim"]:
        """Return the share of each input's prior below a point, whatever it is correlated with."""
        columns = [q.truncated_prior.cdf(x[:, i]) for i, q in enumerate(self.parameters)]
        return np.stack([np.asarray(c, float) for c in columns], axis=1)

    def as_mapping(self, x: Float[np.ndarray, " dim"]) -> Mapping[str, float]:
        """Return the values by name."""
        return dict(zip(self.names, x.tolist(), strict=True))
