"""Size of a pixel: from the study or from the header of a file, never guessed."""

from dataclasses import dataclass

from strandline.imaging.checked import keys_of, number, unfit, word
from strandline.readers.options import TO_MM
from strandline.readers.problems import refused

__all__ = ["SAME", "PixelSize", "agreed"]

UNITS = TO_MM | {"nm": 1e-6}
EXAMPLE = "{x: 6.0, y: 4.0, unit: um} or {size: 6.0, unit: um}"
SMALLEST, LARGEST = 1e-12, 1e9
"""Sizes, mm, that a picture may have; beyond them, areas and their squares overflow."""
SAME = 0.01
"""Largest relative difference between the sizes that the study and a header state."""


@dataclass(frozen=True)
class PixelSize:
    """Size of a pixel as stated, before the refractive index divides y.

    Args:
        x: Size along a row, mm.
        y: Size along a column, mm.
        z: Distance of the planes of a stack, mm, if stated.
        source: Who states it, e.g. ``the study``.

    Raises:
        InvalidInput: A size that no picture has.
    """

    x: float
    y: float
    z: float | None = None
    source: str = "the study"

    def __post_init__(self) -> None:
        for size in (self.x, self.y, self.z):
            if size is not None and not SMALLEST <= size <= LARGEST:
                expected = f"a length from {SMALLEST:g} to {LARGEST:g} mm"
                raise unfit(f"pixel size from {self.source}", f"{size:g} mm", expected, "Correct the size or its unit.")

    @classmethod
    def from_options(cls, options: object, place: str) -> "PixelSize":
        """Return the size that a study file gives at `place`.

        Raises:
            InvalidInput: An option is missing, unknown, or not a length above 0.
        """
        given = keys_of(options, ("x", "y", "z", "size", "unit"), place, EXAMPLE)
        if given.get("unit") is None:
            raise unfit(f"{place}.unit", None, f"one of {', '.join(UNITS)}", f"Add `unit: um` to {place}.")
        factor = UNITS[word(given["unit"], UNITS, f"{place}.unit")]
        if given.keys() - {"unit", "z"} not in ({"size"}, {"x", "y"}):
            raise unfit(place, dict(given), f"x and y, or size: {EXAMPLE}")
        sizes = {
            name: factor * number(value, f"{place}.{name}", "a length above 0", low=5e-324)
            for name, value in given.items()
            if name != "unit"
        }
        square = sizes.get("size", 0.0)
        return cls(sizes.get("x", square), sizes.get("y", square), sizes.get("z"))

    def __str__(self) -> str:
        known = [size for size in (self.x, self.y, self.z) if size is not None]
        return " × ".join(f"{1e3 * size:.6g}" for size in known) + " µm"


def agreed(study: PixelSize | None, header: PixelSize | None, name: str) -> PixelSize:
    """Return the size of a pixel that the study or the header of the file states.

    Args:
        study: Size that the study states.
        header: Size that the header states.
        name: Name of the file in messages.

    Raises:
        Unreadable: Neither states a size, or the two differ by more than 1 %.
    """
    if study is None and header is None:
        raise refused(
            f"{name} does not state the size of a pixel",
            None,
            "the size in the study; the dots per inch of a picture are not its scale",
            "Add e.g. `pixel: {size: 6.0, unit: um}` to the picture.",
        )
    if study is None or header is None:
        return study or header  # type: ignore[return-value]
    for mine, its in zip((study.x, study.y, study.z), (header.x, header.y, header.z), strict=True):
        if mine is not None and its is not None and abs(mine - its) > SAME * its:
            raise refused(
                f"pixel size of {name}: the study and the file disagree",
                f"{study} in the study, {header} from {header.source}",
                "the same size in both, to 1 %",
                "Correct `pixel`, or remove it to take the size from the file.",
            )
    return PixelSize(study.x, study.y, study.z if study.z is not None else header.z, study.source)
