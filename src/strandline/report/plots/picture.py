"""The edge found in a picture: over the picture, along its normals, and what is left when it is smoothed."""

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure, SubFigure

from strandline.imaging import Edge, Picture
from strandline.report.plots.style import BLACK, DOUBLE, GREEN, ORANGE, RED, figure_or_new, legend_under, styled

__all__ = ["plot_picture"]

MM_TO_MICROMETRES = 1e3
MARGIN = 0.1
"""Part of the picture around the edge that is shown, as a share of the edge's extent."""
DARKEST = 0.5, 99.5
"""Percentiles of the grey values that are shown black and white."""


def plot_picture(
    picture: Picture, path: Float[np.ndarray, "click 2"], edge: Edge, *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw the picture with the edge and a band of ± 2 standard deviations, and the strip along its normals.

    Args:
        picture: The picture.
        path: First path, in pixels.
        edge: The edge; lengths in mm.
        figure: Figure to draw in; a new one by default.
    """
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 3.6))
        whole, strip = figure.subplots(1, 2, width_ratios=(1.0, 1.0))
        black, white = np.percentile(picture.values, DARKEST)
        grey = {"cmap": "gray", "vmin": black, "vmax": white, "interpolation": "nearest"}
        whole.imshow(picture.values, **grey)
        far = 2 * edge.errors.sd * edge.normals / np.array(picture.pixel)
        band = np.concatenate([edge.points + far, (edge.points - far)[::-1]])
        whole.fill(*band.T, color=ORANGE, alpha=0.5, linewidth=0, label="± 2 sd of a point")
        whole.plot(*edge.points.T, color=GREEN, linewidth=0.7, label="edge")
        whole.plot(*path.T, color=RED, marker="+", markersize=4, linestyle="none", label="first path")
        (left, bottom), (right, top) = edge.points.min(axis=0), edge.points.max(axis=0)
        around = MARGIN * max(right - left, top - bottom)
        rows, columns = picture.values.shape
        whole.set_xlim(max(left - around, -0.5), min(right + around, columns - 0.5))
        whole.set_ylim(min(top + around, rows - 0.5), max(bottom - around, -0.5))
        whole.set(
            xlabel="x [pixels]", ylabel="y [pixels]", aspect=picture.pixel[1] / picture.pixel[0], title=picture.name
        )
        unit = MM_TO_MICROMETRES * min(picture.pixel)
        places, number = unit * edge.strip.places, len(edge.kept)
        strip.imshow(edge.strip.samples.T, extent=(0, number, places[-1], places[0]), aspect="auto", **grey)
        strip.plot(np.flatnonzero(edge.kept) + 0.5, unit * edge.offsets[edge.kept], color=GREEN, linewidth=0.7)
        for end in np.flatnonzero(np.diff(edge.kept.astype(int))):
            strip.axvline(end + 1, color=BLACK, linestyle=":", linewidth=0.8)
        strip.invert_yaxis()
        strip.set(xlabel="normal", ylabel="distance from the smooth path [µm]", title="along the normals")
        handles, labels = whole.get_legend_handles_labels()
        legend_under(figure, dict(zip(labels, handles, strict=True)))
    return figure
