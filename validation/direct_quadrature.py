"""The posterior of a 2-D biofilm study without any surrogate of the log-likelihood, against the one of the study.

Forward runs on a Chebyshev–Lobatto grid; between its nodes the *interface field* is interpolated (it is smooth, unlike
the log-likelihood), the measure is evaluated on the interpolated interface, and the posterior is integrated adaptively.
The error of the interpolation is seen from the nested grid with half the intervals and from forward runs in between.

Where no steady state exists (soft samples) there is nothing to interpolate: the grid ends at E_low(ν), a fifth above
the fold, and the likelihood on that edge shows how much mass can lie beyond.

Run it with:  python -m validation.direct_quadrature STUDY [STUDY …]      (study folders that `strandline run` finished)
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BarycentricInterpolator

from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import fingerprint
from strandline.quadrature import QuadratureResult, integrate
from strandline.runs import Ledger, RunRecord, run_campaign
from strandline.studies import Study, load_study

OUTPUT = Path(__file__).parent / "output"
INTERVALS = (32, 20)
"""Chebyshev intervals in 1/E and in ν; both even, so that the grid of half as many is nested."""
FOLD = ((-0.8, 83.0), (-0.6, 83.0), (-0.3, 133.0), (0.0, 197.0), (0.2, 234.0), (0.3, 250.0), (0.5, 258.0))
"""(ν, E in Pa) below which no steady state was found at V_in = 100 mm²/s."""
MARGIN = 1.2
E_HIGH, NU_LOW, NU_HIGH, E_BOX_LOW = 800.0, -0.8, 0.5, 100.0
CHECKS = 60


@dataclass(frozen=True)
class FieldTable:
    """Interface points at the nodes of the grid (E-like, ν, coordinate)."""

    t: Float[np.ndarray, " e"]
    nu: Float[np.ndarray, " nu"]
    values: Float[np.ndarray, "e nu coordinate"]

    def at(self, x: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point coordinate"]:
        """Return the interpolated interface points at (E, ν)."""
        t, nu = to_reference(x)
        along_t = barycentric_matrix(self.t, t)
        along_nu = barycentric_matrix(self.nu, nu)
        return np.einsum("pi,pj,ijc->pc", along_t, along_nu, self.values, optimize=True)

    def halved(self) -> "FieldTable":
        """Return the nested table with half the intervals."""
        return FieldTable(self.t[::2], self.nu[::2], self.values[::2, ::2])


def e_low(nu: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
    """Return the softest E of the grid at each ν, by a smooth fit above the fold."""
    at, fold = np.array(FOLD).T
    smooth = np.polynomial.Polynomial.fit(at, MARGIN * fold, 3)
    return np.maximum(smooth(nu), 95.0)


def to_reference(x: Float[np.ndarray, "point 2"]) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Map (E, ν) to [-1, 1]²: linear in 1/E between E_low(ν) and E_HIGH, linear in ν."""
    soft, stiff = 1.0 / e_low(x[:, 1]), 1.0 / E_HIGH
    return 2.0 * (1.0 / x[:, 0] - stiff) / (soft - stiff) - 1.0, 2.0 * (x[:, 1] - NU_LOW) / (NU_HIGH - NU_LOW) - 1.0


def from_reference(t: Float[np.ndarray, " point"], s: Float[np.ndarray, " point"]) -> Float[np.ndarray, "point 2"]:
    """Invert `to_reference`."""
    nu = NU_LOW + 0.5 * (s + 1.0) * (NU_HIGH - NU_LOW)
    soft, stiff = 1.0 / e_low(nu), 1.0 / E_HIGH
    return np.stack([1.0 / (stiff + 0.5 * (t + 1.0) * (soft - stiff)), nu], axis=1)


def barycentric_matrix(nodes: Float[np.ndarray, " n"], x: Float[np.ndarray, " point"]) -> Float[np.ndarray, "point n"]:
    """Return the Lagrange basis of `nodes` at `x`."""
    return np.asarray(BarycentricInterpolator(nodes, np.eye(len(nodes)))(x))


def tabulate(study: Study) -> tuple[FieldTable, Ledger]:
    """Make the forward runs of the grid and return the table of interfaces, with the open ledger."""
    OUTPUT.mkdir(exist_ok=True)
    ledger = Ledger.open(OUTPUT / "ledger.sqlite", model=fingerprint(study.model), description="direct quadrature")
    t, s = (np.cos(np.pi * np.arange(n, -1, -1) / n) for n in INTERVALS)
    grid = np.stack(np.meshgrid(t, s, indexing="ij"), axis=-1).reshape(-1, 2)
    records = run_at(study, ledger, from_reference(grid[:, 0], grid[:, 1]))
    failed = [dict(r.inputs) for r in records if r.interface is None]
    if failed:
        raise SystemExit(f"{len(failed)} nodes of the grid failed, e.g. {failed[0]}: raise MARGIN")
    points = np.array([r.interface.points.ravel() for r in records if r.interface is not None])
    return FieldTable(t, s, points.reshape(len(t), len(s), -1)), ledger


def run_at(study: Study, ledger: Ledger, x: Float[np.ndarray, "run 2"]) -> tuple[RunRecord, ...]:
    """Return the records of forward runs at (E, ν)."""
    inputs = [{**study.fixed, **study.space.as_mapping(row)} for row in x]
    return run_campaign(study.model, inputs, ledger=ledger, executor=study.executor)


def posterior(study: Study, likelihood: InterfaceLikelihood, table: FieldTable) -> QuadratureResult:
    """Integrate prior times likelihood of interpolated interfaces over the part of the box that the grid covers."""

    def log_density(x: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
        result = np.full(len(x), -1e4)
        inside = np.flatnonzero((x[:, 0] >= e_low(x[:, 1])) & (x[:, 0] >= E_BOX_LOW))
        shapes = table.at(x[inside]).reshape(len(inside), -1, 2)
        values = [likelihood(Interface.polyline(points)) for points in shapes]
        result[inside] = np.array(values) + study.space.log_prior(x[inside])
        return result

    return integrate(log_density, study.space.low, study.space.high)


def compare(folder: Path) -> dict[str, object]:
    """Return the direct posterior of one study, its errors, and how far the study's own is from it."""
    study = load_study(folder)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    table, ledger = tabulate(study)
    with ledger:
        (truth,) = run_campaign(study.model, [study.truth or {}], ledger=ledger, executor=study.executor)
        assert truth.interface is not None
        discrepancy = next(iter(study.discrepancies.values()))
        likelihood = InterfaceLikelihood((Observation(truth.interface, study.noise_variance),), discrepancy)
        exact, coarse = (posterior(study, likelihood, grid) for grid in (table, table.halved()))
        between = from_reference(*np.random.default_rng(0).uniform(-1, 1, (2, CHECKS)))
        near = np.random.default_rng(1).multivariate_normal(exact.mean, exact.covariance, CHECKS)
        inside = (near[:, 1] < NU_HIGH) & (near[:, 1] > NU_LOW) & (near[:, 0] > e_low(near[:, 1]))
        checks = np.concatenate([between, near[inside & (near[:, 0] < E_HIGH)]])
        runs = run_at(study, ledger, checks)
    true_points = np.array([r.interface.points for r in runs if r.interface is not None])
    interpolated = table.at(checks).reshape(len(checks), -1, 2)
    errors = [
        abs(likelihood(Interface.polyline(a)) - likelihood(Interface.polyline(b)))
        for a, b in zip(true_points, interpolated, strict=True)
    ]
    edge_nu = np.linspace(NU_LOW, NU_HIGH, 53)
    edge = np.stack([np.maximum(e_low(edge_nu), E_BOX_LOW), edge_nu], axis=1)
    on_edge = [likelihood(Interface.polyline(p)) for p in table.at(edge).reshape(len(edge), -1, 2)]
    mean, sd = (np.array([summary["inputs"][n][key] for n in study.space.names]) for key in ("mean", "sd"))
    return {
        "study": study.name,
        "inputs": list(study.space.names),
        "direct": {"mean": exact.mean.tolist(), "sd": exact.sd.tolist(), "log_evidence": exact.log_evidence},
        "study_posterior": {"mean": mean.tolist(), "sd": sd.tolist(), "log_evidence": summary["log_evidence"]},
        "mean_difference_sd": ((mean - exact.mean) / exact.sd).tolist(),
        "sd_ratio": (sd / exact.sd).tolist(),
        "error": {
            "half_grid_mean_sd": float(np.max(np.abs(coarse.mean - exact.mean) / exact.sd)),
            "half_grid_sd_ratio": float(np.max(np.abs(coarse.sd / exact.sd - 1))),
            "interface_um": float(1e3 * np.abs(true_points - interpolated).max()),
            "log_likelihood_between": float(max(errors[:CHECKS])),
            "log_likelihood_near_posterior": float(max(errors[CHECKS:])),
            "highest_log_likelihood_on_edge": float(max(on_edge)),
            "quadrature_mean_sd": exact.error_mean,
            "quadrature_sd": exact.error_sd,
        },
    }


def main(folders: list[str]) -> None:
    """Print the comparison of each study and write it to output/direct_quadrature.json."""
    results = [compare(Path(folder)) for folder in folders]
    for result in results:
        print(json.dumps(result, indent=1))
    (OUTPUT / "direct_quadrature.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:] or ["studies/biofilm-uniform", "studies/biofilm-uniform-refined"])
