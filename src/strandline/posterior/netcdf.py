"""The posterior as an xarray DataTree in ArviZ's schema, and as a netCDF file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from strandline.foundations import require, whole_file
from strandline.interface import Observation
from strandline.parameters import RESERVED, Parameter, ParameterSpace
from strandline.posterior.posterior import Posterior
from strandline.posterior.random_field import FieldPosterior
from strandline.posterior.under_uncertainty import Cut


def to_datatree(
    posterior: Posterior,
    *,
    seed: int,
    attrs: Mapping[str, str | int | float] | None = None,
    observed: Sequence[Observation] = (),
    number: int | None = None,
    cut: Cut | None = None,
) -> xr.DataTree:
    """Return the posterior as a tree of data sets.

    Groups: ``posterior`` (chain, draw) holds *equally weighted* draws, by default as many as there are particles, to
    which ArviZ's functions apply directly; ``weighted_posterior`` (particle) the particles with their weights,
    log-likelihood and log prior; ``prior`` (chain, draw) draws of the prior; ``observed_data`` the observed interfaces;
    ``field_NAME`` (point) what is known of a random field at its points.
    No time is recorded: the same posterior and seed, that of the resampling and of the draws from the prior, yield the
    same content.

    With nuisance inputs, the joint reading of the posterior under uncertainty is ``posterior`` without their columns.
    The cut reading, if it is given, has ``cut_posterior`` and ``weighted_cut_posterior``, the latter with the values of
    the nuisance inputs and the log-evidence for each. `attrs` are further attributes of the root, e.g. the study's
    name.
    """
    size = posterior.number if number is None else number
    equal = posterior.equally_weighted(np.random.default_rng([seed, 0]), size)
    uniform = np.random.default_rng([seed, 1]).random((size, posterior.space.dim))
    prior = posterior.space.prior_quantiles(np.clip(uniform, 1e-12, 1 - 1e-12))
    groups = {
        "posterior": _draws(posterior.space, equal),
        "weighted_posterior": _particles(posterior),
        "prior": _draws(posterior.space, prior),
    }
    if cut is not None:
        chosen = cut.extended.equally_weighted(np.random.default_rng([seed, 2]), number)
        groups |= {"cut_posterior": _draws(posterior.space, chosen), "weighted_cut_posterior": _conditionals(cut)}
    groups |= {f"field_{name}": _field(found) for name, found in posterior.fields.items()}
    if observed:
        groups["observed_data"] = _observed(observed)
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {"inference_library": "strandline", "seed": seed, **dict(attrs or {})}
    return tree


def from_datatree(tree: xr.DataTree, space: ParameterSpace) -> Posterior:
    """Return the weighted posterior in a tree from `to_datatree`, for the inputs of `space`."""
    return _posterior(tree["weighted_posterior"].to_dataset(), space)


def cut_from_datatree(tree: xr.DataTree, space: ParameterSpace) -> Cut | None:
    """Return the cut reading in a tree from `to_datatree`, or None if there is none."""
    if "weighted_cut_posterior" not in tree.children:
        return None
    data = tree["weighted_cut_posterior"].to_dataset()
    return Cut(
        extended=_posterior(data, space),
        values=data["nuisance_values"].to_numpy(),
        log_evidence=data["conditional_log_evidence"].to_numpy(),
        value_index=data["value_index"].to_numpy(),
    )


def _posterior(data: xr.Dataset, space: ParameterSpace) -> Posterior:
    missing = [name for name in space.names if name not in data]
    stored = sorted(str(name) for name in data.data_vars if name not in RESERVED)
    words = f"all of {list(space.names)}", "Read it with the parameters it was written with."
    require(not missing, "inputs of the stored posterior", stored, *words)
    return Posterior(
        space=space,
        draws=np.stack([data[name].to_numpy() for name in space.names], axis=1),
        log_weights=data["log_weight"].to_numpy(),
        log_likelihood=data["log_likelihood"].to_numpy(),
        log_prior=data["log_prior"].to_numpy(),
        log_evidence=float(data.attrs["log_evidence"]),
    )


def write(tree: xr.DataTree, path: Path) -> None:
    """Write the tree to a netCDF file, whole or not at all."""
    with whole_file(path) as partial:
        tree.to_netcdf(partial, engine="h5netcdf")


def read(path: Path) -> xr.DataTree:
    """Return the tree in a netCDF file, loaded into memory; the file is closed."""
    words = "a netCDF file that `write` made", "Check the path, or run the calibration first."
    require(path.is_file(), "file of a posterior", str(path), *words)
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        return tree.load()


def _draws(space: ParameterSpace, values: Float[np.ndarray, "draw dim"]) -> xr.Dataset:
    columns = zip(space, values.T, strict=True)
    variables = {p.name: (("chain", "draw"), column[None], _attributes(p)) for p, column in columns}
    return xr.Dataset(variables, coords={"chain": [0], "draw": np.arange(len(values))})


def _particles(posterior: Posterior) -> xr.Dataset:
    columns = zip(posterior.space, posterior.draws.T, strict=True)
    variables: dict[str, Any] = {p.name: ("particle", column, _attributes(p)) for p, column in columns}
    for name, column in {
        "weight": posterior.weights,
        "log_weight": posterior.log_weights,
        "log_likelihood": posterior.log_likelihood,
        "log_prior": posterior.log_prior,
    }.items():
        variables[name] = ("particle", column)
    figures = {"log_evidence": posterior.log_evidence, "effective_sample_size": posterior.ess}
    return xr.Dataset(variables, coords={"particle": np.arange(posterior.number)}, attrs=figures)


def _field(found: FieldPosterior) -> xr.Dataset:
    unit, support, low_high = found.field.unit, found.field.support, found.interval()
    of: dict[str, Any] = {
        "points": (("point", "xyz"), support.points, {"units": "mm"}),
        "weight": ("point", support.weights, {"long_name": "length or area that a point stands for"}),
        "mean": ("point", found.mean, {"units": unit}),
        "sd": ("point", found.sd, {"units": unit}),
        "low": ("point", low_high[0], {"units": unit, "long_name": "5 % quantile"}),
        "high": ("point", low_high[1], {"units": unit, "long_name": "95 % quantile"}),
        "share_of_prior_sd_left": ("point", found.share_left, {"units": "1"}),
    }
    return xr.Dataset(of, attrs={"prior": repr(found.field.prior), "share_of_variance": found.field.share})


def _conditionals(cut: Cut) -> xr.Dataset:
    """Return the particles of the cut reading, with the values of the nuisance inputs that they belong to."""
    space = cut.extended.space
    relative = "log of the likelihood over the evidence given the nuisance inputs"
    data = _particles(cut.extended)
    data["log_likelihood"].attrs["long_name"] = relative
    return data.assign(
        value_index=("particle", cut.value_index),
        nuisance_values=(("nuisance_value", "nuisance_input"), cut.values),
        conditional_log_evidence=("nuisance_value", cut.log_evidence),
    ).assign_coords(nuisance_input=[space.names[i] for i in space.nuisance])


def _attributes(parameter: Parameter) -> dict[str, Any]:
    low, high = parameter.interval
    known = {"units": parameter.unit, "low": low, "high": high, "prior": repr(parameter.prior)}
    return known | ({"nuisance": 1} if parameter.nuisance else {})


def _observed(observed: Sequence[Observation]) -> xr.Dataset:
    conditions = [o.condition for o in observed]
    words = "a different name for each", "Name the conditions."
    require(len(set(conditions)) == len(conditions), "conditions of the observations", conditions, *words)
    variables = {}
    for o in observed:
        suffix = f"_{o.condition}" if o.condition else ""
        attributes = {"units": "mm", **o.noise.facts}
        variables[f"interface{suffix}"] = ((f"point{suffix}", "xyz"), o.interface.points, attributes)
        variables[f"cells{suffix}"] = ((f"cell{suffix}", "corner"), o.interface.cells, {})
    return xr.Dataset(variables)
