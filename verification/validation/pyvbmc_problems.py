"""The two problems of the comparison with PyVBMC: the built-in biofilm, and an outline with seven inputs."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.reproduction.field_table import FieldTable, LoadCoordinates, tabulate
from verification.reproduction.grid_posterior import GridPosterior, ProductGrid, posterior_on_grid, product_grid
from verification.reproduction.grid_posterior import total_variation as variation
from verification.reproduction.truth import TruePosterior, true_posterior
from verification.validation.tables import STUDIES

from strandline.design.active import Knowledge
from strandline.discrepancy import Currents, TrackedPoints
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import Normal, Parameter, ParameterSpace, Uniform
from strandline.runs import InProcess, Ledger, RunRecord, RunRequest, attempt
from strandline.studies import Study, load_study

NOISE = 0.0005
"""σ_N² in mm², as in the study."""
LEVELS = (0.2, 0.1, 0.05)
"""Of the total variation. Further figures of a problem: runs of a batch, most runs of ours and of the peer's, which
iterations of the peer are boosted, and seeds."""
RATE = 100.0
INTERVALS = (16, 8, 0)
"""Intervals of the table in s and ν, with V fixed."""


@dataclass(frozen=True, eq=False)
class Biofilm:
    """(E, ν) of the built-in biofilm, observed without noise; the true posterior comes from quadrature.

    Within its range, a table of the model replaces runs; outside it the model itself is run. The folder keeps its runs.
    """

    folder: Path
    key = "biofilm"
    title = "biofilm, E and ν"
    levels = LEVELS
    batch, most, boost, seeds = 2, (60, 120), 1, 5
    discrepancy = Currents(0.005, quadrature="refined")

    @cached_property
    def study(self) -> Study:
        return load_study(STUDIES / "biofilm-uniform")

    @property
    def space(self) -> ParameterSpace:
        return self.study.space

    @cached_property
    def known(self) -> tuple[FieldTable, TruePosterior]:
        """The table and the true posterior."""
        model: Any = self.study.model
        box = LoadCoordinates(rate=(1.0, RATE))
        with Ledger.open(self.folder / "table.sqlite", model=model) as ledger:
            start, runs = model.undeformed(), InProcess()
            table = tabulate(model, start, intervals=INTERVALS, ledger=ledger, executor=runs, coordinates=box)
        likelihood = InterfaceLikelihood(self._observed(table), self.discrepancy)
        return table, true_posterior(table, likelihood, self.space, rate=RATE)

    @staticmethod
    def _observed(table: FieldTable) -> tuple[Observation, ...]:
        return (Observation(Interface.polyline(table.at(np.array([[400.0, 0.3, RATE]]))[0]), NOISE),)

    @cached_property
    def observations(self) -> tuple[Observation, ...]:
        return self._observed(self.known[0])

    def run(self, x: Float[np.ndarray, " dim"]) -> RunRecord:
        table, inputs = self.known[0], {**self.space.as_mapping(x), "V_in": RATE}
        at = np.array([[x[0], x[1], RATE]])
        if table.coordinates.inside(at)[0]:
            return RunRecord("", inputs, "ok", {"": Interface.polyline(table.at(at)[0])})
        with tempfile.TemporaryDirectory() as folder:
            return attempt(self.study.model, RunRequest("", inputs), Path(folder))

    def ours(self, known: Knowledge) -> float:
        """Return the total variation between the posterior from `known` and the truth."""
        found = posterior_on_grid(lambda x: known.expected(np.ascontiguousarray(x[:, :2])), self.space, self._grid)
        return variation(found, self._truth)

    def asked(self) -> Mapping[str, object]:
        """Return what the peer must report on its posteriors: their densities at the points in a file."""
        path = self.folder / "grid.npz"
        np.savez(path, points=self._grid.plane(RATE)[:, :2])
        return {"at": str(path)}

    def theirs(self, answer: Float[np.ndarray, " point"]) -> float:
        """Return the total variation between densities at the points of the grid and the truth."""
        area, density = self._grid.area.ravel(), answer
        return float(0.5 * np.sum(np.abs(density / (density @ area) - self._truth.density.ravel()) * area))

    def accuracy(self) -> dict[str, float]:
        """Return the accuracy of the truth: how far the posteriors of halved discretisations are from it."""
        true = self.known[1]
        return {
            "runs of the table": float(self.known[0].runs),
            "total variation, half the table's intervals": float(true.from_half_table.total_variation or 0.0),
            "total variation, half the nodes of log L": float(true.from_half_field.total_variation or 0.0),
            "mass beyond the table": true.posterior.edge_mass,
        }

    @cached_property
    def _grid(self) -> ProductGrid:
        return product_grid(self.space, panels=(24, 12, 1), rate=RATE)

    @cached_property
    def _truth(self) -> GridPosterior:
        return posterior_on_grid(self.known[1].field, self.space, self._grid)


@dataclass(frozen=True, eq=False)
class Outline:
    """A half circle of radius ½ mm, pushed outwards by c V Σ φᵢ(s) (1 + νᵢ/2)/Eᵢ: seven inputs, three quantities seen.

    The data inform only aᵢ = V (1 + νᵢ/2)/Eᵢ: four directions in the space of inputs are ridges, bounded by the priors.
    With tracked points log L is a quadratic form in a, so that 10⁷ draws from the prior are weighted in seconds.
    The folder keeps the truth.
    """

    folder: Path
    draws: int = 60_000_000
    key = "outline"
    title = "outline, 7 inputs"
    levels = LEVELS
    batch, most, boost, seeds = 8, (122, 300), 4, 3
    discrepancy = TrackedPoints()
    space = ParameterSpace(
        (
            *(Parameter(f"E{k}", Uniform(100.0, 800.0), unit="Pa") for k in (1, 2, 3)),
            *(Parameter(f"nu{k}", Uniform(-0.8, 0.5)) for k in (1, 2, 3)),
            Parameter("V", Normal(100.0, 10.0), unit="mm^2/s", box=(60.0, 140.0)),
        )
    )
    truth = (300.0, 400.0, 500.0, 0.3, 0.0, -0.3, 100.0)
    points, scale, bins = 41, 0.4, 25
    kept_draws, block = 20_000, 1_000_000

    def amplitudes(self, x: Float[np.ndarray, "point 7"]) -> Float[np.ndarray, "point 3"]:
        return np.asarray(x[:, 6:] * (1 + 0.5 * x[:, 3:6]) / x[:, :3])

    @cached_property
    def shapes(self) -> Float[np.ndarray, "3 point"]:
        s = np.linspace(0, 1, self.points)
        return np.asarray(np.exp(-0.5 * ((s - np.array([[0.2], [0.5], [0.8]])) / 0.15) ** 2))

    def interface(self, x: Float[np.ndarray, "7"]) -> Interface:
        angle = np.pi * (1 - np.linspace(0, 1, self.points))
        normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        push = self.scale * self.amplitudes(x[None])[0] @ self.shapes
        return Interface.polyline((0.5 + push)[:, None] * normal)

    def run(self, x: Float[np.ndarray, " dim"]) -> RunRecord:
        return RunRecord("", self.space.as_mapping(x), "ok", {"": self.interface(x)})

    @cached_property
    def observations(self) -> tuple[Observation, ...]:
        return (Observation(self.interface(np.array(self.truth)), NOISE),)

    def log_likelihood(self, x: Float[np.ndarray, "point 7"]) -> Float[np.ndarray, " point"]:
        apart = self.amplitudes(x) - self.amplitudes(np.array([self.truth]))
        gram = self.scale**2 * self.shapes @ self.shapes.T
        return np.asarray(-0.5 / NOISE * np.einsum("pi,ij,pj->p", apart, gram, apart))

    @cached_property
    def known(self) -> Mapping[str, np.ndarray]:
        """Edges of bins, marginals of the truth and of its two halves, and draws from L^¼ p at which to compare."""
        kept = self.folder / "outline.npz"
        if not kept.exists():
            self._agree()
            np.savez(kept, **self._weighted())
        with np.load(kept) as content:
            return dict(content)

    def _agree(self) -> None:
        """Check the closed form against the measure on outlines."""
        x = self.space.prior_quantiles(np.random.default_rng(3).random((20, self.space.dim)))
        likelihood = InterfaceLikelihood(self.observations, self.discrepancy)
        np.testing.assert_allclose(self.log_likelihood(x), [likelihood(self.interface(row)) for row in x], rtol=1e-9)

    def _weighted(self) -> dict[str, np.ndarray]:
        rng = np.random.default_rng(7)
        edges = np.linspace(self.space.low, self.space.high, self.bins + 1, axis=1)
        halves, squares, some = np.zeros((2, self.space.dim, self.bins)), 0.0, []
        blocks = self.draws // self.block
        for k in range(blocks):
            x = self.space.prior_quantiles(rng.random((self.block, self.space.dim)))
            log = self.log_likelihood(x)
            near = log > -40
            x, log = x[near], log[near]
            weight = np.exp(log)
            halves[k % 2] += marginals(x, weight, edges)
            squares += float(weight @ weight)
            picked = rng.random(len(x)) < np.exp(0.25 * log)  # draws from L^¼ p by rejection
            some.append((x[picked], log[picked]))
        total = halves[:, 0].sum()
        x, log = (np.concatenate(parts) for parts in zip(*some, strict=True))
        chosen = rng.permutation(len(x))[: self.kept_draws]
        return {
            "edges": edges,
            "marginals": halves.sum(axis=0) / total,
            "halves": halves / halves.sum(axis=2, keepdims=True),
            "effective": np.array(total**2 / squares),
            "x": x[chosen],
            "log": log[chosen],
        }

    def ours(self, known: Knowledge) -> float:
        """Return the mean marginal variation, with both posteriors as weights of the same draws."""
        truth = self.known
        weights = [np.exp(value - 0.25 * truth["log"]) for value in (truth["log"], known.expected(truth["x"]))]
        a, b = (marginals(truth["x"], w / w.sum(), truth["edges"]) for w in weights)
        return _mean_variation(a, b)

    def asked(self) -> Mapping[str, object]:
        """Return what the peer must report on its posteriors: draws."""
        return {"draws": 100_000}

    def theirs(self, answer: Float[np.ndarray, "draw 7"]) -> float:
        """Return the mean marginal variation between draws and the truth."""
        found = marginals(answer, np.full(len(answer), 1 / len(answer)), self.known["edges"])
        return _mean_variation(found, self.known["marginals"])

    def accuracy(self) -> dict[str, float]:
        halves = self.known["halves"]
        return {
            "draws of the prior": float(self.draws),
            "effective draws": float(self.known["effective"]),
            "mean marginal variation between its halves": _mean_variation(halves[0], halves[1]),
            "draws at which active designs are compared": float(len(self.known["x"])),
        }


def marginals(x: np.ndarray, weight: np.ndarray, edges: np.ndarray) -> Float[np.ndarray, "dim bin"]:
    """Return the weight in each bin of each input."""
    return np.stack([np.histogram(x[:, k], edges[k], weights=weight)[0] for k in range(x.shape[1])])


def _mean_variation(a: Float[np.ndarray, "dim bin"], b: Float[np.ndarray, "dim bin"]) -> float:
    return float(0.5 * np.abs(a - b).sum(axis=1).mean())
