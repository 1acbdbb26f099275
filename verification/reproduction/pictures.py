"""The pictures of the page, numbered as the study's figures: from the studies' reports, and further ones."""

import base64
import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from matplotlib.figure import Figure
from verification.reproduction.evidence import Evidence
from verification.reproduction.figures import (
    plot_convergence,
    plot_nested_likelihoods,
    plot_parts,
    plot_surrogate_errors,
)

from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.model import Biofilm
from strandline.report.figure_files import PAGE_PIXELS_PER_INCH
from strandline.report.plots.style import DOTS_PER_INCH, styled

__all__ = ["FROM_REPORTS", "Picture", "draw"]


@dataclass(frozen=True)
class Picture:
    """A picture of the page: its number in the study, with a letter if there are several, its caption and its PNG."""

    number: str
    caption: str
    png: bytes

    @property
    def data(self) -> str:
        """The PNG as HTML needs it."""
        return base64.b64encode(self.png).decode("ascii")

    @property
    def width(self) -> int:
        """Width on the page in pixels: the width of the PNG at the resolution of the page."""
        return round(int.from_bytes(self.png[16:20], "big") * PAGE_PIXELS_PER_INCH / DOTS_PER_INCH)


FROM_REPORTS = (
    ("3", "biofilm-uniform", "flow", "Velocity, pressure and displacement at the ground truth."),
    ("4", "biofilm-uniform", "interfaces", "The observed interface, the undeformed one, and those of some runs."),
    ("5", "biofilm-measures", "likelihood", "Likelihood over its maximum under three measures; grey: failed runs."),
    ("6", "biofilm-measures", "log_likelihood", "Log-likelihood under three measures."),
    ("7", "biofilm-measures", "log_likelihood_sd", "Standard deviation of the surrogates."),
    ("9a", "biofilm-uniform", "posterior", "S3: posterior under the uniform prior."),
    ("9a, refined", "biofilm-uniform-refined", "posterior", "The same with the refined quadrature of the currents."),
    ("9b", "biofilm-uniform", "particles", "S3: the particles, area and colour by weight."),
    ("9c", "biofilm-informed", "posterior", "S4: posterior under the informed prior."),
    ("9d", "biofilm-inflow", "posterior_joint", "S5: posterior under uncertainty, joint reading."),
    ("9d, cut", "biofilm-inflow", "posterior_cut", "S5: posterior under uncertainty, cut reading."),
    ("10", "biofilm-inflow", "nuisance", "S5: prior of the inflow, and its posterior in the joint reading."),
    ("13", "biofilm-parts", "marginals", "S6: marginals with priors."),
    ("14", "biofilm-parts", "posterior", "S6: pairs of inputs."),
    ("15", "biofilm-parts", "parallel", "S6: all particles, drawn from low to high posterior density."),
)
"""Number, study, name of the file in its folder of figures, caption."""


def draw(evidence: Evidence) -> Iterator[Picture]:
    """Yield all pictures; those of the reports are taken from the studies' folders of figures."""
    for number, study, name, caption in FROM_REPORTS:
        path = evidence.studies[study].folder / "figures" / f"{name}.png"
        yield Picture(number, caption, path.read_bytes())
    yield from _nested(evidence)
    yield Picture("11", "S6: the three parts of the specimen.", _png(_parts(evidence)))
    for key, words in (("log_likelihood", "log-likelihood"), ("likelihood", "likelihood")):
        errors = {rule: getattr(found, key) for rule, found in evidence.convergence.items()}
        sizes = next(iter(evidence.convergence.values())).sizes
        axes = plot_surrogate_errors(sizes, errors, quantity=f"relative L² error of the {words}")
        caption = f"S6: error of the surrogate of the {words} at later points of the Sobol sequence."
        yield Picture("12" if key == "log_likelihood" else "12, likelihood", caption, _png(axes.figure))


def _nested(evidence: Evidence) -> Iterator[Picture]:
    study, calibration = evidence.studies["biofilm-uniform"], evidence.outcomes["biofilm-uniform"].calibration
    names = study.space.names
    training = np.array([[record.inputs[name] for name in names] for record in calibration.records if record.ok])
    truth = None if study.truth is None else np.array([study.truth[name] for name in names])
    for rule, steps in evidence.nested.items():
        figure = plot_nested_likelihoods(
            steps, evidence.truths.certain[rule].posterior, study.space, training=training, ground_truth=truth
        )
        caption = (
            f"S2: likelihood of nested designs, {rule} quadrature, with the contours of the true model's (dashed); "
            "TV is the total variation between the two posteriors."
        )
        yield Picture("8" if rule == "centre" else f"8, {rule}", caption, _png(figure))
    axes = plot_convergence(evidence.nested)
    caption = "S2: total variation to the true posterior and leave-one-out error, which a user sees, against the runs."
    yield Picture("8, errors", caption, _png(axes.figure))


def _parts(evidence: Evidence) -> Figure:
    model: Any = evidence.studies["biofilm-parts"].model
    assert isinstance(model, Biofilm)
    mesh: Any = mesh_flow_cell(model.outline.interface(), MESHES[model.mesh], model.channel, model.partition)
    points = np.array([vertex.point for vertex in mesh.vertices], float)
    solids = [f"solid{k + 1}" for k in range(len(model.partition.markers))]
    names = {"fluid": "fluid"} | {solid: f"part {k + 1}" for k, solid in enumerate(solids)}
    cells = {
        label: np.array([[v.nr for v in e.vertices] for e in mesh.Elements(ng.VOL) if e.mat == name])
        for name, label in names.items()
    }
    figure = plot_parts(points, cells).figure
    assert isinstance(figure, Figure)
    return figure


def _png(figure: Any) -> bytes:
    buffer = io.BytesIO()
    with styled():
        figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()
