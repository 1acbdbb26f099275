"""The edge found in a picture with its residuals, and surfaces, cut by three planes."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.ndimage import gaussian_filter1d

from strandline.imaging import Edge, Mesh, Picture, Stack, cut
from strandline.interface import Interface
from strandline.report.plots import style

MARGIN = 0.1
"""Part of the picture around the edge that is shown, as a share of the edge's extent."""
DARKEST = 0.5, 99.5
"""Percentiles of the grey values that are shown black and white."""
NEAR, SDS = 6.0, 8.0
"""Half the side of what is shown enlarged: at least so many pixels, and so many standard deviations of a point."""
SMOOTH, LENGTHS = 5.0, 2.0
"""Standard deviation of the Gaussian along the edge that smooths it for the residual: at least so many pixels, and so
many correlation lengths of the errors, which would else be smoothed away."""


@style.drawn()
def plot_picture(picture: Picture, path: Float[np.ndarray, "click 2"], edge: Edge) -> Figure:
    """Draw the edge in the picture, a part of it enlarged, the strip along its normals, and its residuals.

    The bands are ± 2 standard deviations of a point. They are too narrow to be seen in the whole picture, so a part of
    it is enlarged, around the middle of the edge. The first path is in pixels; lengths of the edge are in mm.
    """
    figure = style.new_figure(style.DOUBLE, 5.8)
    (whole, near), (strip, residual) = figure.subplots(2, 2, height_ratios=(1.25, 1.0))
    black, white = np.percentile(picture.values, DARKEST)
    grey = {"cmap": "gray", "vmin": black, "vmax": white, "interpolation": "nearest"}
    _whole(whole, picture, path, edge, grey)
    _near(near, whole, picture, edge, grey)
    _strip(strip, picture, edge, grey)
    _residual(residual, edge)
    style.legend_under(figure, style.labelled(whole, near, strip, residual))
    return figure


def off_smooth(edge: Edge) -> Float[np.ndarray, " point"]:
    """Return the distance of each point of an edge from the edge smoothed along itself, in the unit of its arc."""
    number = len(edge.kept)
    offsets = np.interp(np.arange(number), np.flatnonzero(edge.kept), edge.offsets[edge.kept])
    sigma = max(SMOOTH, LENGTHS * edge.errors.length / edge.errors.spacing)
    smooth = gaussian_filter1d(offsets, sigma, mode="wrap" if edge.closed else "nearest")
    return np.asarray(edge.unit * (offsets - smooth)[edge.kept])


def _whole(ax: Axes, picture: Picture, path: Float[np.ndarray, "click 2"], edge: Edge, grey: Any) -> None:
    ax.imshow(picture.values, **grey)
    ax.plot(*edge.points.T, color=style.GREEN, linewidth=0.7, label="edge")
    ax.plot(*path.T, color=style.RED, marker="+", markersize=4, linestyle="none", label="first path")
    shown = np.concatenate([edge.points, path])
    (left, bottom), (right, top) = shown.min(axis=0), shown.max(axis=0)
    around = MARGIN * max(right - left, top - bottom)
    rows, columns = picture.values.shape
    ax.set_xlim(max(left - around, -0.5), min(right + around, columns - 0.5))
    ax.set_ylim(min(top + around, rows - 0.5), max(bottom - around, -0.5))
    ax.set(xlabel="x [pixels]", ylabel="y [pixels]", aspect=picture.pixel[1] / picture.pixel[0], title=picture.name)


def _near(ax: Axes, whole: Axes, picture: Picture, edge: Edge, grey: Any) -> None:
    """Draw the middle of the edge enlarged, with its band, and frame it in the whole picture."""
    pixel = np.array(picture.pixel)
    centre = edge.points[len(edge.points) // 2]
    half = max(NEAR * edge.unit, SDS * edge.errors.sd) / pixel
    ax.imshow(picture.values, **grey)
    far = 2 * edge.errors.sd * edge.normals / pixel
    for k, part in enumerate(_pieces(edge)):
        band = np.concatenate([(edge.points + far)[part], (edge.points - far)[part][::-1]])
        ax.fill(*band.T, color=style.ORANGE, alpha=0.5, linewidth=0, label="± 2 sd of a point" if k == 0 else None)
    ax.plot(*edge.points.T, color=style.GREEN, linewidth=0.7, marker=".", markersize=3.0)
    (left, top), (right, bottom) = centre - half, centre + half
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect=pixel[1] / pixel[0])
    ax.set(xlabel="x [pixels]", ylabel="y [pixels]", title="the frame on the left, enlarged")
    whole.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, edgecolor=style.SKY, linewidth=1.0))


def _pieces(edge: Edge) -> list[Int[np.ndarray, " _"]]:
    """Return the numbers of the points in each piece of an edge, between regions left out."""
    return np.split(np.arange(len(edge.points)), np.flatnonzero(np.diff(np.flatnonzero(edge.kept)) > 1) + 1)


def _strip(ax: Axes, picture: Picture, edge: Edge, grey: Any) -> None:
    unit = style.TO_MICROMETRES * min(picture.pixel)
    places, number = unit * edge.strip.places, len(edge.kept)
    ax.imshow(edge.strip.samples.T, extent=(0, number, places[-1], places[0]), aspect="auto", **grey)
    ax.plot(np.flatnonzero(edge.kept) + 0.5, unit * edge.offsets[edge.kept], color=style.GREEN, linewidth=0.7)
    for end in np.flatnonzero(np.diff(edge.kept.astype(int))).tolist():
        ax.axvline(end + 1, color=style.BLACK, linestyle=":", linewidth=0.8, label="end of what is used")
    ax.invert_yaxis()
    ax.set(xlabel="normal", ylabel="distance from the smooth path [µm]", title="along the normals")


def _residual(ax: Axes, edge: Edge) -> None:
    band = 2 * style.TO_MICROMETRES * edge.errors.sd
    values, arc = style.TO_MICROMETRES * off_smooth(edge), edge.arc - edge.arc[0]
    ax.axhspan(-band, band, color=style.ORANGE, alpha=0.3, linewidth=0)
    ax.axhline(0.0, color=style.BLACK, linewidth=0.8)
    for part in _pieces(edge):
        ax.plot(arc[part], values[part], color=style.GREEN, linewidth=0.6)
    low, high = ax.get_ylim()
    ax.set_ylim(min(low, -1.5 * band), max(high, 1.5 * band))
    ax.set(xlabel="arc length [mm]", ylabel="residual [µm]", title="the edge minus the smoothed edge")


AXES = "xyz"


@style.drawn()
def plot_surfaces(observed: Interface, simulated: Mapping[str, Interface]) -> Figure:
    """Draw an observed surface and simulated ones, mm, cut through its middle at right angles to the axes."""
    figure = style.new_figure(style.DOUBLE, 2.9)
    middle = 0.5 * (observed.points.min(axis=0) + observed.points.max(axis=0))
    shown = {"observed": (observed, style.BLACK, 1.6)}
    shown |= {label: (one, style.CYCLE[k % len(style.CYCLE)], 0.9) for k, (label, one) in enumerate(simulated.items())}
    lines = {}
    for ax, (normal, across, up) in zip(figure.subplots(1, 3), ((2, 0, 1), (1, 0, 2), (0, 1, 2)), strict=True):
        for label, (surface, colour, width) in shown.items():
            segments = cut(Mesh(surface.points, surface.cells), normal, float(middle[normal]))[:, :, [across, up]]
            lines[label] = LineCollection(list(segments), colors=colour, linewidths=width, label=label)
            ax.add_collection(lines[label])
        ax.autoscale()
        ax.set(xlabel=f"{AXES[across]} [mm]", ylabel=f"{AXES[up]} [mm]", aspect="equal")
        ax.set_title(f"{AXES[normal]} = {middle[normal]:.3g} mm")
    style.legend_under(figure, lines)
    return figure


@style.drawn()
def plot_stack(stack: Stack, mesh: Mesh) -> Figure:
    """Draw three slices of a stack through the middle of a surface, in voxels, at right angles to each axis."""
    figure = style.new_figure(style.DOUBLE, 2.6)
    middle = np.rint(0.5 * (mesh.points.min(axis=0) + mesh.points.max(axis=0))).astype(int)
    for ax, (normal, across, down) in zip(figure.subplots(1, 3), ((2, 0, 1), (1, 0, 2), (0, 2, 1)), strict=True):
        place = int(np.clip(middle[normal], 0, stack.values.shape[2 - normal] - 1))
        grey = stack.values.take(place, axis=2 - normal)
        grey = grey if across < down else grey.T
        black, white = np.percentile(grey, DARKEST)
        ax.imshow(grey, cmap="gray", vmin=black, vmax=white, interpolation="nearest")
        segments = cut(mesh, normal, place + 1e-6)[:, :, [across, down]]
        ax.add_collection(LineCollection(list(segments), colors=style.GREEN, linewidths=0.8))
        ax.set(xlabel=f"{AXES[across]} [voxels]", ylabel=f"{AXES[down]} [voxels]")
        ax.set(title=f"{AXES[normal]} = {place}", aspect=stack.voxel[down] / stack.voxel[across])
    return figure
