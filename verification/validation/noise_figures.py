"""Figures of the guide "Choose the noise": what a pixel, repeats, roughness and residuals say of the errors of points.

They take a few seconds. Run it with:  python -m verification.validation.noise_figures
"""

import numpy as np
from contourpy import contour_generator
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from verification.validation.tables import DOCS

from strandline.discrepancy import errors_from_repeats, errors_from_roughness, signed_distances
from strandline.interface import Interface, PointErrors
from strandline.report.plots.style import BLACK, BLUE, GREEN, GREY, RED, styled

TRUE = PointErrors(0.003, 0.012)
"""The errors of the drawn contours, mm."""
RADIUS, MIDDLE, BLUR, GRAIN = 14.3, (19.6, 20.2), 0.8, 0.04
"""A bright disk in a picture of 40 × 40 pixels: lengths in pixels, and the noise as a share of the contrast."""


def outline() -> Interface:
    """Return a hill of 300 points at equal distances, 1.6 mm long."""
    x = np.linspace(0.0, 1.2, 600)
    return Interface.polyline(np.stack([x, 0.4 * np.sin(np.pi * x / 1.2) ** 2], axis=1)).resampled(300)


def along(polyline: Interface) -> Float[np.ndarray, " point"]:
    """Return the arc length of each point of an open polyline, mm."""
    return np.concatenate([[0.0], np.cumsum(polyline.lengths)])


def pixel(left: Axes, right: Axes) -> None:
    """Draw a bright disk with soft edge and grain, and the errors of its contour in whole pixels and between them."""
    y, x = np.mgrid[0:40, 0:40]
    away = np.hypot(x - MIDDLE[0], y - MIDDLE[1]) - RADIUS
    grain = GRAIN * np.random.default_rng(1).standard_normal(away.shape)
    picture = 1 / (1 + np.exp(away / (0.6 * BLUR))) + grain
    left.imshow(picture, cmap="gray", origin="lower", interpolation="nearest")
    found = {"whole pixels": (np.round(np.clip(picture, 0, 1)), RED), "between pixels": (picture, BLUE)}
    for name, (grey, colour) in found.items():
        line = max(contour_generator(z=grey).lines(0.5), key=len)
        left.plot(*line.T, color=colour)
        arm = line - np.array(MIDDLE)
        places, errors = RADIUS * (np.arctan2(arm[:, 1], arm[:, 0]) % (2 * np.pi)), np.hypot(*arm.T) - RADIUS
        order = np.argsort(places)
        right.plot(places[order], errors[order], color=colour, label=f"{name}, sd {errors.std():.2f}")
    left.set(xlim=(2, 18), ylim=(22, 36), xticks=[], yticks=[])
    right.set(xlabel="along the edge, pixels", ylabel="error, pixels", ylim=(-0.9, 1.3), xlim=(0, 60))
    right.legend(loc="upper right", ncols=2)


def repeats(left: Axes, right: Axes) -> None:
    """Draw contours of one state, and their offsets with the sd and the correlation length found."""
    truth, random = outline(), np.random.default_rng(2)
    contours = [TRUE.draw(truth, random) for _ in range(8)]
    found = errors_from_repeats(contours).errors
    for k, contour in enumerate(contours):
        left.plot(*contour.points.T, color=BLUE, linewidth=0.5)
        right.plot(along(truth), 1e3 * signed_distances(contour.points, truth), color=BLUE if k == 0 else GREY, lw=0.6)
    zoomed(left)
    sd, length = 1e3 * found.sd, 1e3 * found.length
    band(right, sd, f"± sd, {sd:.1f} µm", found.length, f"length, {length:.0f} µm")
    right.set(ylabel="offset, µm", xlim=(0.3, 0.7))


def roughness(left: Axes, right: Axes) -> None:
    """Draw a contour with its true outline, and its distances to that with the sd found from its roughness."""
    truth = outline()
    contour = TRUE.draw(truth, np.random.default_rng(3))
    found = errors_from_roughness(contour)
    left.plot(*contour.points.T, color=BLUE, linewidth=0.8, label="contour")
    left.plot(*truth.points.T, color=BLACK, linewidth=0.8, linestyle="--", label="outline")
    zoomed(left)
    left.legend(loc="upper left")
    sd, true = 1e3 * found.errors.sd, 1e3 * TRUE.sd
    right.plot(along(truth), 1e3 * signed_distances(contour.points, truth), color=BLUE, linewidth=0.7)
    band(right, sd, f"± sd found, {sd:.1f} µm (true {true:.1f})", found.window, "window")
    right.set(ylabel="error, µm", xlim=(0.3, 1.1))


def band(ax: Axes, sd: float, said: str, length: float, name: str) -> None:
    """Draw ± one standard deviation, µm, and a bar of a length, mm, along the outline."""
    ax.axhspan(-sd, sd, color=GREEN, alpha=0.25, linewidth=0, label=said)
    ax.plot([0.4, 0.4 + length], 2 * [-3.4 * sd], color=RED, lw=2.5, label=name)
    ax.set(xlabel="along the outline, mm", ylim=(-4 * sd, 5.5 * sd))
    ax.legend(loc="upper right", ncols=2)


def zoomed(ax: Axes) -> None:
    """Show a piece of the outline in which single points can be seen."""
    ax.set(xlim=(0.2, 0.5), ylim=(0.08, 0.36), xlabel="x, mm", ylabel="y, mm", aspect="equal")


def unknown(left: Axes, right: Axes) -> None:
    """Draw independent residuals, and the probability density of their sd after more and more of them."""
    residuals = 3.0 * np.random.default_rng(4).standard_normal(300)
    left.plot(residuals, ".", color=BLUE, markersize=3)
    left.axhline(0.0, color=BLACK, linewidth=0.8)
    left.set(xlabel="point", ylabel="residual of the best fit, µm")
    sd = np.geomspace(1.8, 5.0, 400)
    for number, colour in ((30, GREY), (100, BLUE), (300, RED)):
        logarithm = -number * np.log(sd) - 0.5 * float((residuals[:number] ** 2).sum()) / sd**2
        density = np.exp(logarithm - logarithm.max())
        right.plot(sd, density / np.trapezoid(density, sd), color=colour, label=f"{number} points")
    right.axvline(3.0, color=BLACK, linewidth=0.8, linestyle="--", label="true")
    right.set(xlabel="sd, µm", ylabel="density")
    right.legend(loc="upper right")


if __name__ == "__main__":
    for draw in (pixel, repeats, roughness, unknown):
        with styled():
            figure = Figure(figsize=(7.0, 2.6), layout="constrained")
            draw(*figure.subplots(1, 2))
            figure.savefig(DOCS / "figures" / f"noise-{draw.__name__}.png", dpi=130)
