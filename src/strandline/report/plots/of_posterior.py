"""Figures of one posterior, drawn into axes of your own."""

from dataclasses import dataclass
from typing import Any

from strandline.errors import InvalidInput
from strandline.posterior import Posterior
from strandline.report.plots.corner import plot_corner
from strandline.report.plots.joint import plot_hexagons, plot_pairs
from strandline.report.plots.marginals import plot_marginal, plot_marginals
from strandline.report.plots.particles import plot_particles

__all__ = ["PosteriorPlots"]


@dataclass(frozen=True, repr=False)
class PosteriorPlots:
    """Draws figures of a posterior; each method returns the axes, or the figure, that it drew in.

    Args:
        posterior: Weighted draws.
    """

    posterior: Posterior

    def __repr__(self) -> str:
        return "<plots: corner, joint, marginal, marginals, pairs, particles>"

    def corner(self, **options: Any) -> Any:
        """Draw all marginals and the regions with 68 and 95 % of each pair of inputs; options of `plot_corner`."""
        return plot_corner(self.posterior, **options)

    def joint(self, x: str | None = None, y: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the joint density of two inputs, by default the first two; options of `plot_hexagons`."""
        return plot_hexagons(self.posterior, self._two(x, y), ax=ax, **options)

    def particles(self, x: str | None = None, y: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the weighted particles in the plane of two inputs; options of `plot_particles`."""
        return plot_particles(self.posterior, self._two(x, y), ax=ax, **options)

    def marginal(self, name: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the marginal of an input, by default the first, with its prior; options of `plot_marginal`."""
        return plot_marginal(self.posterior, name or self.posterior.space.names[0], ax=ax, **options)

    def marginals(self, **options: Any) -> Any:
        """Draw the marginals of all inputs; options of `plot_marginals`."""
        return plot_marginals(self.posterior, **options)

    def pairs(self, **options: Any) -> Any:
        """Draw the joint densities of all pairs of inputs; options of `plot_pairs`."""
        return plot_pairs(self.posterior, **options)

    def _two(self, x: str | None, y: str | None) -> tuple[str, str]:
        names = self.posterior.space.names
        if len(names) < 2:
            raise InvalidInput(
                "joint density of two inputs",
                value=f"a posterior of {names[0]} alone",
                expected="a posterior of two inputs or more",
                remedy="Draw .plot.marginal() instead.",
            )
        first = x or next(name for name in names if name != y)
        return first, y or next(name for name in names if name != first)
