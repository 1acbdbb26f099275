"""RKHS norm of the difference of two interfaces as currents, Eqs. (10)-(11) of the study."""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from strandline.discrepancy import kernel_integrals as integrals
from strandline.discrepancy.many_currents import currents_of_many
from strandline.discrepancy.protocol import ManyPoints, Offsets, Snapshot, Values, require_alike, require_same_direction
from strandline.foundations import require, require_types
from strandline.interface import Interface, PointErrors, spacings

QUADRATURES = ("refined", "centre")
_FINEST = 1e-14
_THINNEST, _WIDEST = 1e-9, 1e9  # widths beyond which squares overflow or vanish, mm
_NEGLIGIBLE = 0.01  # error of d²/σ_N² that changes no posterior
_LOOSEST = 1e-3
_SAFETY = 1 / 50  # share of the tolerance that one inner product may use up: d² = ⟨S,S⟩ - 2⟨S,T⟩ + ⟨T,T⟩ adds up four


@dataclass(frozen=True)
class Currents:
    """d² = ⟨S,S⟩ - 2⟨S,T⟩ + ⟨T,T⟩ of the simulated S and the observed T, mm² (mm⁴ for surfaces); Eqs. (10)-(11).

    ⟨S,T⟩ = ∫_S ∫_T exp(-|x-y|²/2σ_W²) n(x)·m(y) dy dx with unit normals n, m, over polylines or surfaces. (The other
    convention in the literature, exp(-r²/σ²), is this one with width σ/√2.) Nodes need not correspond and nothing is
    projected, but both interfaces must have the same orientation: a simulated interface that runs against the observed
    one is refused.

    Args:
        width: Width σ_W of the kernel, mm.
        quadrature: Rule: ``refined`` (default) integrates both interfaces to `tolerance`, whatever their nodes.
            ``centre`` takes one point per segment or triangle, as the study does: cheap, but wrong if these are longer
            than the width, since d² then depends on where the nodes lie along the interface.
        tolerance: Largest error of d² with ``refined``, relative to ⟨T,T⟩.

    For observed points with sd s and correlation length ℓ (at least half their spacing), the noise variance σ_N² is
    2√(2π) s²ℓ/σ_W on polylines, if σ_W is not below their spacing: far below the norm of the noise itself, which is
    mostly of high frequency. On surfaces it is 4π² s²ℓ², mm⁴. A study with ``noise: {sd: s, length: ℓ, unit: mm}``
    takes it.

    ⟨T,T⟩ is kept for the most recently used observed interfaces.

    Raises:
        InvalidInput: a width not above 0, an unknown quadrature, a tolerance outside (0, 0.1].
        InvalidInterface: on evaluation, interfaces that run against each other.
    """

    width: float
    quadrature: str = field(default="refined", kw_only=True)
    tolerance: float = field(default=1e-6, kw_only=True)
    unit: ClassVar[str] = "mm²"
    surface_unit: ClassVar[str] = "mm⁴"

    def __post_init__(self) -> None:
        require_types(self)
        width = f"a length in mm above 0, from {_THINNEST:g} to {_WIDEST:g}"
        for name, right, expected, remedy in (
            ("width", _THINNEST <= self.width <= _WIDEST, width, "A tenth of the largest displacement is a start."),
            ("quadrature", self.quadrature in QUADRATURES, f"one of {', '.join(QUADRATURES)}", "Choose one of them."),
            ("tolerance", 0 < self.tolerance <= 0.1, "a number in (0, 0.1]", "Leave it out for 1e-6."),
        ):
            require(right, f"{name} of the currents measure", getattr(self, name), expected, remedy)

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d² ≥ 0, mm² (mm⁴); a value below 0 from rounding counts as 0."""
        require_alike(simulated, observed)
        require_same_direction(simulated, observed)
        square, share = _bound(self, Snapshot.of(observed))
        cross, own = (self._product(simulated, one, share) for one in (observed, simulated))
        return max(own - 2 * cross + square, 0.0)

    def inner(self, a: Interface, b: Interface) -> float:
        """Return ⟨a,b⟩, mm² (mm⁴), to `tolerance` relative to ⟨b,b⟩."""
        require_alike(a, b)
        return self._product(a, b, _bound(self, Snapshot.of(b))[1])

    def many(self, points: ManyPoints, template: Interface, observed: Interface) -> Values | None:
        """Return d² of polylines with the same segments, mm², to `tolerance`; None for surfaces and for few runs."""
        if template.dim == 3:
            return None
        (square, share), refined = _bound(self, Snapshot.of(observed)), self.quadrature == "refined"
        return currents_of_many(
            *(points, template.cells, observed.points, observed.cells),
            width=self.width,
            square=square,
            tolerance=(self.tolerance if refined else _FINEST) * square,
            share=share if refined else None,
        )

    def of_offsets(self, offsets: Offsets, observed: Interface, nodes: int) -> Values | None:
        """Return 2√(2π) σ_W ∫ (1 - exp(-δ²/2σ_W²)) dt, for curves that are the distance δ apart and nearly parallel.

        None for the quadrature ``centre``, which depends on where the nodes lie.
        """
        if self.quadrature == "centre":
            return None
        apart = -np.expm1(-0.5 * (offsets / self.width) ** 2)
        return np.asarray(2 * math.sqrt(2 * math.pi) * self.width * (apart @ spacings(observed)))

    def tolerating(self, variance: float, observed: Interface) -> "Currents":
        """Return the measure with the largest tolerance that σ_N² = `variance`, mm² (mm⁴), allows, at least its own.

        It changes log L by less than 0.01, since d² is off by at most `tolerance` ⟨T,T⟩.
        """
        if self.quadrature != "refined":
            return self
        enough = _NEGLIGIBLE * variance / _bound(self, Snapshot.of(observed))[0]
        return replace(self, tolerance=max(self.tolerance, min(enough, _LOOSEST)))

    def noise_variance(self, errors: PointErrors, observed: Interface) -> float | None:
        """Return σ_N² = 2√(2π) s²ℓ/σ_W, mm², with ℓ at least half the spacing h of the observed points.

        A small normal error e gives d² = ∬ e(t) e(t') q(t - t') with ∫q = √(2π)/σ_W, and errors of low frequency have
        the spectral density 2s²ℓ. On surfaces ∫q = 2π, whatever the width, and the density is s² 2πℓ², with 2πℓ² at
        least the area of a point: σ_N² = 4π² s²ℓ², mm⁴. None for a width below h, where segments or triangles are seen
        one by one.
        """
        if observed.dim == 3:
            areas = spacings(observed)
            if self.width**2 < float(np.median(areas)):
                return None
            return 2 * math.pi * float((errors.local_variances(observed) * areas**2).sum() / areas.sum())
        if self.width < float(np.median(observed.lengths)):
            return None
        return 2 * math.sqrt(2 * math.pi) * errors.sd**2 * errors.effective_length(observed) / self.width

    def _product(self, a: Interface, b: Interface, share: float) -> float:
        if self.quadrature == "centre":
            return integrals.centre_product(a, b, self.width)
        refined = integrals.refined_surface_product if a.dim == 3 else integrals.refined_product
        return refined(a, b, self.width, tolerance=share)


@lru_cache(maxsize=64)
def _bound(measure: Currents, snapshot: Snapshot) -> tuple[float, float]:
    """Return ⟨T,T⟩ and the tolerance of a product with T, smaller if ⟨T,T⟩ is small because normals cancel."""
    observed, share = snapshot.interface, _SAFETY * measure.tolerance
    square = measure._product(observed, observed, share)
    cancelled = square / integrals.natural_scale(observed, measure.width)
    if measure.quadrature == "refined" and cancelled < 1:
        share = max(share * cancelled, _FINEST)
        square = measure._product(observed, observed, share)
    return square, share
