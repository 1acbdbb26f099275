"""What was observed: an interface, its noise, and the condition it belongs to."""

from dataclasses import dataclass

from strandline.errors import InvalidInput
from strandline.interface.interface import Interface
from strandline.interface.noise import GaussianNoise, Noise
from strandline.interface.point_errors import PointErrors
from strandline.interface.unknown_errors import UnknownErrors
from strandline.text import is_label

__all__ = ["Observation", "is_condition"]


@dataclass(frozen=True, eq=False, init=False)
class Observation:
    """An observed interface and its noise.

    Args:
        interface: Observed interface, mm.
        noise: Noise model of the measure; or the errors of the observed points, known or unknown, from which the noise
            of every measure follows; a number is the variance σ_N² of Gaussian noise, in the unit of d².
        condition: Experimental condition or time; "" if the model has only one, without a name.

    Raises:
        InvalidInput: A variance that is not a finite number above 0, or something that is not a noise model.
    """

    interface: Interface
    noise: Noise | PointErrors | UnknownErrors
    condition: str = ""

    def __init__(
        self, interface: Interface, noise: Noise | PointErrors | UnknownErrors | float, condition: str = ""
    ) -> None:
        if isinstance(noise, int | float) and not isinstance(noise, bool):
            noise = GaussianNoise(float(noise))
        if not isinstance(noise, Noise | PointErrors | UnknownErrors) or isinstance(noise, type):
            raise InvalidInput(
                "noise of an observation",
                value=noise,
                expected="a noise model, the errors of the points, or the variance σ_N² in the unit of d²",
                remedy="Give e.g. PointErrors(sd=0.003), or 0.001; strandline.interface.Noise lists its parts.",
            )
        object.__setattr__(self, "interface", interface)
        object.__setattr__(self, "noise", noise)
        object.__setattr__(self, "condition", condition)

    def reversed(self) -> "Observation":
        """Return the same observation in the other direction; standard deviations of its points go with them."""
        each = isinstance(self.noise, PointErrors) and self.interface.dim == 2
        noise = self.noise.reversed() if each and isinstance(self.noise, PointErrors) else self.noise
        return Observation(self.interface.reversed(), noise, self.condition)


def is_condition(name: object) -> bool:
    """Return whether `name` can name a condition: "" for the only one, else a short text valid in file names."""
    return isinstance(name, str) and is_label(name) and name == name.strip() and not set(name) & set("/\\")
