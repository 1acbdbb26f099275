"""The pictures of the page, numbered as the study's figures: from the studies' reports, and further ones."""

import base64
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from verification.reproduction.designs import NestedStep
from verification.reproduction.evidence import Evidence

from strandline.models.biofilm.mesh.geometry import MESHES, mesh_flow_cell
from strandline.report.plots import FieldGrid, plot_field, style
from strandline.report.plots.style import CYCLE, DASHES, DOTS_PER_INCH, PAGE_PIXELS_PER_INCH, new_axes, styled

WINDOW_SDS, POINTS = 5.0, (121, 101)
LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)
COLOURS = ("#dbe9f4", "#7fb3d5", "#f0b27a", "#82c39b", "#c39bd3", "#f7dc6f")


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
    for rule in evidence.nested:
        caption = (
            f"S2: likelihood of nested designs, {rule} quadrature, with the contours of the true model's (dashed); "
            "TV is the total variation between the two posteriors."
        )
        yield Picture("8" if rule == "centre" else f"8, {rule}", caption, _png(plot_nested_likelihoods(evidence, rule)))
    caption = "S2: total variation to the true posterior and leave-one-out error, which a user sees, against the runs."
    yield Picture("8, errors", caption, _png(plot_convergence(evidence.nested).figure))
    with styled():
        ax = new_axes(style.DOUBLE, 3.8)
        plot_parts(evidence.studies["biofilm-parts"].model, ax)
    yield Picture("11", "S6: the three parts of the specimen.", _png(ax.figure))
    for key, words in (("log_likelihood", "log-likelihood"), ("likelihood", "likelihood")):
        errors = {rule: getattr(found, key) for rule, found in evidence.convergence.items()}
        sizes = evidence.convergence["centre"].sizes
        axes = plot_surrogate_errors(sizes, errors, quantity=f"relative L² error of the {words}")
        caption = f"S6: error of the surrogate of the {words} at later points of the Sobol sequence."
        yield Picture("12" if key == "log_likelihood" else "12, likelihood", caption, _png(axes.figure))


def _png(figure: Any) -> bytes:
    buffer = io.BytesIO()
    with styled():
        figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()


def plot_nested_likelihoods(evidence: Evidence, rule: str) -> Figure:
    """Draw exp(surrogate - its maximum) of each nested design, the runs it used, and contours of the true posterior."""
    steps, truth = evidence.nested[rule], evidence.truths.certain[rule].posterior
    study, calibration = evidence.studies["biofilm-uniform"], evidence.outcomes["biofilm-uniform"].calibration
    space = study.space
    training = np.array([[record.inputs[name] for name in space.names] for record in calibration.records if record.ok])
    at = None if study.truth is None else np.array([study.truth[name] for name in space.names])
    low = np.maximum(truth.mean - WINDOW_SDS * truth.sd, space.low)
    high = np.minimum(truth.mean + WINDOW_SDS * truth.sd, space.high)
    e, nu = (np.linspace(a, b, n) for a, b, n in zip(low, high, POINTS, strict=True))
    points = np.stack(np.meshgrid(e, nu, indexing="ij"), axis=-1).reshape(-1, 2)
    contours = {"levels": LEVELS, "colors": "black", "linewidths": 0.6, "linestyles": "dashed"}
    with styled():
        figure, panels = style.panel_grid(len(steps), 1.8, margin=0.6, sharex=True, sharey=True)
        for ax, step in zip(panels, steps, strict=True):
            values = step.surrogate.process.mean(points).reshape(POINTS)
            grid = FieldGrid(*space.parameters, e, nu, values, truth=at)
            plot_field(grid, kind="likelihood", colour_bar=False, legend=False, ax=ax)
            ax.contour(truth.grid.young, truth.grid.nu, (truth.density / truth.density.max()).T, **contours)
            used = training[: step.succeeded]
            ax.plot(*used.T, "o", color="white", markersize=2.6, markeredgecolor=style.BLACK, markeredgewidth=0.3)
            ax.set(xlim=(e[0], e[-1]), ylim=(nu[0], nu[-1]))
            ax.set_title(f"{step.runs} runs, TV {step.total_variation:.2g}")
            ax.label_outer()
        figure.colorbar(panels[0].collections[0], ax=panels, label="likelihood / maximum", pad=0.01)
    return figure


def plot_convergence(steps: Mapping[str, Sequence[NestedStep]]) -> Axes:
    """Draw total variation to the truth (lines) and leave-one-out error near the mode (dashed) against the runs."""
    sizes = [step.runs for step in next(iter(steps.values()))]
    variations = {rule: [step.total_variation for step in sequence] for rule, sequence in steps.items()}
    ax = plot_surrogate_errors(sizes, variations, quantity="error")
    with styled():
        for colour, (rule, sequence) in zip(CYCLE, steps.items(), strict=False):
            errors = [step.surrogate.validation.loo_rms_near_mode for step in sequence]
            label = f"{rule}, leave-one-out near the mode"
            ax.plot(sizes, errors, "s", linestyle=DASHES[1], fillstyle="none", color=colour, label=label)
        style.below(ax, columns=2)
    return ax


def plot_surrogate_errors(sizes: Sequence[int], errors: Mapping[str, Sequence[float]], *, quantity: str) -> Axes:
    """Draw the errors of each case against the number of training runs, both on logarithmic scales."""
    with styled():
        ax = new_axes(style.SINGLE, 2.8)
        for (case, values), colour in zip(errors.items(), CYCLE, strict=False):
            ax.loglog(sizes, values, "o-", markersize=4, color=colour, label=case)
        ax.set(xlabel="training runs", ylabel=quantity)
        ax.set_xticks(list(sizes), [f"{n:d}" for n in sizes])
        ax.minorticks_off()
        ax.legend()
    return ax


def plot_parts(model: Any, ax: Axes) -> None:
    """Draw the triangles of the fluid and of each part of the specimen in its own colour."""
    mesh: Any = mesh_flow_cell(model.outline.interface(), MESHES[model.mesh], model.channel, model.partition)
    x, y = np.array([vertex.point for vertex in mesh.vertices], float).T
    names = {"fluid": "fluid"} | {f"solid{k}": f"part {k}" for k in range(1, 1 + len(model.partition.markers))}
    for name, colour in zip(names, COLOURS, strict=False):
        cells = np.array([[v.nr for v in e.vertices] for e in mesh.Elements(ng.VOL) if e.mat == name])
        look = {"cmap": ListedColormap([colour]), "edgecolors": "0.4", "lw": 0.3, "rasterized": True}
        ax.tripcolor(x, y, cells, facecolors=np.zeros(len(cells)), **look)
    handles = [Patch(facecolor=colour, edgecolor="0.4") for colour in COLOURS[: len(names)]]
    ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    ax.legend(handles, list(names.values()), loc="upper right", ncols=len(names))
