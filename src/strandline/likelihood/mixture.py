"""A Gaussian likelihood of the signed distances of the observed points, averaged over unknown levels of the errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, softmax

from strandline.interface import ErrorModel, Interface
from strandline.likelihood.joint_errors import JointErrors, Points
from strandline.likelihood.residuals import sums_of

__all__ = ["Mixture"]


@dataclass(frozen=True, eq=False)
class Mixture:
    """log Σ_k w_k exp(-½ d_k²), d_k² = rᵀ C_k⁻¹ r with C_k = κ_k V + B S_k² Bᵀ and S_k diagonal.

    Args:
        joint: The observed interfaces with typical errors; their global errors are the first columns of B.
        local: Diagonal of V, all observations one after the other.
        shared: B, what one unit of each shared error does to the signed distances, mm.
        levels: Levels κ_k of the local errors, mm².
        scales: Diagonals of S_k.
        log_weights: log w_k.
    """

    joint: JointErrors
    local: Float[np.ndarray, " seen"]
    shared: Float[np.ndarray, "seen error"]
    levels: Float[np.ndarray, " level"]
    scales: Float[np.ndarray, "level error"]
    log_weights: Float[np.ndarray, " level"]

    def one(self, interfaces: Mapping[str, Interface]) -> float:
        """Return log L of simulated interfaces by condition."""
        points = {seen.condition: interfaces[seen.condition].points[None] for seen in self.joint.observations}
        return float(self.many(points, interfaces)[0])

    def many(self, points: Points, templates: Mapping[str, Interface]) -> Float[np.ndarray, " run"]:
        """Return log L of each run, given its points by condition."""
        return self.of_sums(*sums_of(self.joint, points, templates, self.model, self._global_errors))

    @cached_property
    def model(self) -> ErrorModel:
        """V and B."""
        return ErrorModel(self.local, self.shared)

    def _global_errors(self, products: Float[np.ndarray, "run error"]) -> Float[np.ndarray, "run error"]:
        """Return the most probable global errors at the likeliest level; other shared errors stay as they are."""
        likeliest = int(np.argmax(self.log_weights))
        level, scale = self.levels[likeliest], self.scales[likeliest]
        inverse = np.linalg.inv(level * np.eye(len(scale)) + scale[:, None] * self.model.gram * scale)
        found = (products * scale) @ inverse * scale
        found[:, self.joint.model.shared.shape[1] :] = 0.0
        return np.asarray(found)

    def of_sums(
        self, squares: Float[np.ndarray, " run"], products: Float[np.ndarray, "run error"]
    ) -> Float[np.ndarray, " run"]:
        """Return log L from Σ r²/V and e = BᵀV⁻¹r, for d² = Σ r²/(κV) - (Se)ᵀ (κ²I + κ S G S)⁻¹ Se, G = BᵀV⁻¹B."""
        values = np.empty((len(self.levels), len(squares)))
        for k, (level, inverse) in enumerate(zip(self.levels, self._inverses, strict=True)):
            values[k] = squares / level - ((products @ inverse) * products).sum(axis=1)
        return np.asarray(logsumexp(self.log_weights[:, None] - 0.5 * values, axis=0))

    def weights_of_sums(
        self, gram: Float[np.ndarray, "term term"], products: Float[np.ndarray, "term error"]
    ) -> Float[np.ndarray, "term term"]:
        """Return the mean of FᵀC_k⁻¹F over the components, each as likely as the first column of F makes it.

        Args:
            gram: FᵀV⁻¹F.
            products: FᵀV⁻¹B.
        """
        inverses = zip(self.levels, self._inverses, strict=True)
        each = np.array([gram / level - products @ inverse @ products.T for level, inverse in inverses])
        return np.asarray(np.tensordot(softmax(self.log_weights - 0.5 * each[:, 0, 0]), each, axes=1))

    @property
    def _inverses(self) -> Float[np.ndarray, "level error error"]:
        """S_k (κ_k²I + κ_k S_k G S_k)⁻¹ S_k."""
        G = self.model.gram
        S, levels = self.scales, self.levels[:, None, None]
        inner = levels**2 * np.eye(len(G)) + levels * S[:, :, None] * G * S[:, None, :]
        return np.asarray(S[:, :, None] * np.linalg.inv(inner) * S[:, None, :])
