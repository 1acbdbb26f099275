"""The stored posterior: ArviZ reads it rightly, writing is repeatable and leaves no half file behind."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from strandline.errors import InvalidInput
from strandline.interface import Interface, Observation
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior, from_datatree, read, to_datatree, write
from strandline.priors import ScaledBeta, Uniform

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import arviz

SPACE = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", ScaledBeta(3.0, 2.0, -0.8, 0.5))))
SEEN = Observation(Interface.polyline(np.array([[0.0, 0.0], [0.5, 0.4], [1.0, 0.0]])), 5e-4, "t1")


def weighted_posterior(number: int = 300) -> Posterior:
    draws = SPACE.prior_quantiles(np.random.default_rng(0).uniform(size=(number, 2)))
    log_likelihood = -0.5 * ((draws[:, 0] - 300) / 80) ** 2 + 2 * draws[:, 1]
    log_weights = log_likelihood - np.logaddexp.reduce(log_likelihood)
    return Posterior(SPACE, draws, log_weights, log_likelihood, SPACE.log_prior(draws), -3.5)


def test_the_summary_of_arviz_is_the_weighted_mean_and_the_prior_group_holds_the_prior(tmp_path):
    posterior, path = weighted_posterior(4000), tmp_path / "posterior.nc"
    tree = to_datatree(posterior, seed=1)
    write(tree, path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        summary = arviz.summary(arviz.from_netcdf(path), round_to="none")
    error = 4 * posterior.sd / np.sqrt(posterior.ess)
    assert list(summary.index) == ["E", "nu"]
    assert (np.abs(summary["mean"].to_numpy() - posterior.mean) < error).all()
    np.testing.assert_allclose(summary["sd"], posterior.sd, rtol=0.1)
    planted = np.abs(posterior.draws.mean(axis=0) - posterior.mean)
    assert (planted > error).all(), "storing the particles as if they had equal weights must be caught"
    for parameter in SPACE:
        uniform = np.sort(parameter.truncated_prior.cdf(tree["prior"][parameter.name].to_numpy().ravel()))
        assert np.abs(uniform - (np.arange(4000) + 0.5) / 4000).max() < 1.63 / np.sqrt(4000)


def test_the_documented_way_to_arviz_works_with_the_major_version_installed(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "read-results.md").read_text("utf-8")
    (snippet,) = re.findall(r"```python\n(import arviz as az\n.*?)```", page, re.DOTALL)
    path = tmp_path / "studies" / "biofilm-uniform" / "posterior.nc"
    path.parent.mkdir(parents=True)
    write(to_datatree(weighted_posterior(), seed=1, observed=[SEEN]), path)
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "read-results.md", "exec"), {})
    heading, *rows = capsys.readouterr().out.splitlines()
    assert heading.split()[:2] == ["mean", "sd"]
    assert [row.split()[0] for row in rows] == ["E", "nu"]


def test_a_posterior_survives_the_file_which_depends_on_its_content_alone(tmp_path):
    posterior = weighted_posterior()
    files = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        tree = to_datatree(posterior, seed=seed, attrs={"study": "S3"}, observed=[SEEN], number=50)
        write(tree, tmp_path / f"{name}.nc")
        files.append((tmp_path / f"{name}.nc").read_bytes())
    assert files[0] == files[1] != files[2]
    back = read(tmp_path / "c.nc")
    (tmp_path / "c.nc").unlink()
    assert back.identical(tree)
    assert back.attrs == {"inference_library": "strandline", "seed": 4, "study": "S3"}
    assert back["posterior"]["E"].attrs["units"] == "Pa"
    assert back["posterior"]["E"].dims == ("chain", "draw")
    assert back["posterior"].sizes["draw"] == 50
    np.testing.assert_array_equal(back["observed_data"]["interface_t1"], SEEN.interface.points)
    assert back["observed_data"]["interface_t1"].attrs["noise_variance"] == 5e-4
    again = from_datatree(back, SPACE)
    np.testing.assert_array_equal(again.draws, posterior.draws)
    np.testing.assert_array_equal(again.log_weights, posterior.log_weights)
    assert again.log_evidence == posterior.log_evidence
    assert back["weighted_posterior"]["weight"].sum() == pytest.approx(1.0)
    assert back["weighted_posterior"].attrs["effective_sample_size"] == pytest.approx(posterior.ess)
    with pytest.raises(InvalidInput, match="rho"):
        from_datatree(back, ParameterSpace((Parameter("rho", Uniform(0.0, 1.0)),)))


def test_a_write_replaces_the_file_at_once_or_leaves_the_old_one(tmp_path):
    """A reader that holds the old file keeps it whole: it is replaced, not written over."""
    path = tmp_path / "posterior.nc"
    write(to_datatree(weighted_posterior(50), seed=3), path)
    before = path.read_bytes()
    with pytest.raises((TypeError, ValueError)):
        write(xr.DataTree(xr.Dataset({"x": ("n", [object()])})), path)
    assert path.read_bytes() == before
    with path.open("rb") as reader:
        write(to_datatree(weighted_posterior(60), seed=3), path)
        assert reader.read() == before
    assert path.read_bytes() != before
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]


def test_bad_paths_and_conditions_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="netCDF"):
        read(tmp_path / "none.nc")
    with pytest.raises(InvalidInput, match="conditions"):
        to_datatree(weighted_posterior(5), seed=0, observed=[SEEN, SEEN])
