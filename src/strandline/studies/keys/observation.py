"""The keys `observation` and `noise` of study.yaml."""

from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from strandline.interface import MOST, is_condition
from strandline.readers import Reading
from strandline.studies.keys.schema import VARIANCES, Name, Number, Section, Seed, Switch, with_keys_of

Place = Annotated[list[Number], Field(min_length=2, max_length=2)]


class RegisteredTo(Section):
    """Another picture of the same set-up, and what does not move from one to the other."""

    to: str | Annotated[list[str], Field(min_length=1)]
    """the other picture, e.g. of the undeformed specimen, or frames of it; `frame` is then the model's place in it"""
    marks: str | None = None
    """file of clicks on that picture, with its fixed regions and the origin"""
    fixed: list[Annotated[list[Place], Field(min_length=3)]] = []
    """or the fixed regions themselves, polygons in pixels of that picture"""

    @property
    def files(self) -> list[str]:
        return [self.to] if isinstance(self.to, str) else list(self.to)


class _Picture(Section):
    """The keys that pictures and stacks of them have in common; `strandline.imaging` checks most of them."""

    file: str | Annotated[list[str], Field(min_length=1)]
    """the picture, relative to the study folder; a list, or a folder: frames of one state, averaged; of a stack, the
    planes from the first to the last"""
    index: Any = None
    """refractive index by which depths, along y, are divided"""
    scale: Any = None
    """what the numbers are: `intensity` (default), `amplitude`, `log10`, `dB` or `sRGB`"""
    channel: Any = None
    """of a colour picture: `grey` (default), `red`, `green` or `blue`"""
    dataset: Any = None
    """name of the data set in an HDF5 file"""
    reader: Any = None
    """[your own reader](../how-to/extend.md#a-picture-format) of the file, `module:name`; default: by its suffix"""
    solid: Literal["bright", "dark"]
    """the side of the model: the brighter or the darker one"""

    @property
    def files(self) -> list[str]:
        return [self.file] if isinstance(self.file, str) else list(self.file)

    @property
    def reading(self) -> dict[str, Any]:
        names = ("pixel", "page", "average", "index", "scale", "channel", "dataset", "reader")
        return {name: value for name in names if (value := getattr(self, name, None)) is not None}


class ImageFile(_Picture):
    """A picture with the observed interface; `strandline.imaging` checks `edge`, and from `pixel` to `frame`."""

    pixel: Any = None
    """size of a pixel, `{size: 3.1, unit: um}` or `{x: 6, y: 4, unit: um}`; needed unless the file's header or a scale
    bar in the file of clicks states it"""
    page: Any = None
    """page of a TIFF, from 0"""
    average: Any = None
    """`true`: the mean of all pages, as frames of one state"""
    frame: Any = None
    """where the model's (0, 0) is, `{origin: [212, 640]}` in pixels from the left and the top; with `x: left` or
    `y: down` if the model's axes point there, and `rotation` in degrees"""
    registration: RegisteredTo | None = None
    """where the set-up is in this picture: [found](../how-to/picture.md#two-pictures-of-one-specimen) from another one
    of it"""
    path: str | list[Place]
    """the interface, roughly: a file of clicks (`strandline image STUDY --edit` makes one), three or more pixels
    [[x, y], …], or `model`, the model's own outline"""
    closed: Switch = False
    """whether the interface is closed"""
    edge: Any = "erf"
    """how the edge is found: `erf` for cameras, `path` for speckle, `contour` for the half level of clean pictures; or
    [your own](../how-to/extend.md#an-edge-method), `{method: "module:name", options: {…}}`"""
    trim: Annotated[Number, Field(ge=0, lt=0.5)] = 0.05
    """share of the edge left out at each end of an open one"""
    exclude: list[Annotated[list[Place], Field(min_length=3)]] = []
    """polygons in pixels in which the interface is not used"""


class StackFile(_Picture):
    """A stack of pictures with the observed surface; `strandline.imaging` checks the keys from `voxel` to `exclude`."""

    voxel: Any = None
    """size of a voxel, `{x: 0.2, y: 0.2, z: 0.5, unit: um}`; needed unless the file's header states it"""
    frame: Any = None
    """where the model's (0, 0, 0) is, `{origin: [128, 128, 64]}` in voxels from the left, the top and the first plane;
    with `x: left`, `y: up` or `z: first` if the model's axes point there, and `rotation: [0, 0, 30]` in degrees about
    its x, y and z axes"""
    exclude: list[Any] = []
    """regions in which the surface is not used: `{box: [[0, 0, 0], [10, 10, 5]], unit: um}` or
    `{ball: [5, 5, 0], radius: 2, unit: um}` in the model's coordinates, or `{voxels: [[0, 0, 0], [50, 50, 9]]}`"""
    triangles: Annotated[int, Field(ge=100, le=50_000)] = 5000
    """most triangles of the surface"""
    smooth: Annotated[Number, Field(ge=0, le=5)] | None = None
    """standard deviation of the Gaussian that smooths the stack, in sides of a voxel; default: 1, up to 2 if noisy"""


ONE, SEVERAL = "[one]", "[several]"  # branches of `observation`, as pydantic names them in the location of an error


class ObservationNoise(Section):
    """Noise on the node coordinates of a synthetic observation."""

    sd: Annotated[Number, Field(gt=0)]
    """standard deviation of noise added to each node coordinate of a `synthetic` observation, mm, above 0"""
    seed: Seed | None = None
    """its seed; default: the study's `seed`"""


class _Source(Section):
    """A file with an observed interface."""

    file: str | None = None
    """observed [interface](#files), relative to the study folder"""
    unit: Literal["mm", "um", "µm", "m"] | None = None
    """unit of length: `mm`, `um`, `µm` or `m`; required with `file`"""


READ = tuple(one.name for one in fields(Reading) if one.name not in ("file", "unit"))
_Read: Any = with_keys_of(_Source, Reading, READ)


class ObservationFile(_Read):  # type: ignore[misc]
    """Where the observed interface comes from: a file, or a run of the model itself.

    `strandline.readers` checks the keys between `unit` and `synthetic`.
    """

    model_config = ConfigDict(use_attribute_docstrings=True)
    synthetic: dict[str, Number] | None = None
    """instead of `file`: a value for each input; the model makes the observation; coefficients of a field, `E_1`, are 0
    by default"""
    image: ImageFile | None = None
    """instead of `file`: [a picture](../how-to/picture.md) in which the interface is found"""
    stack: StackFile | None = None
    """instead of `file`: [a stack of pictures](../how-to/picture.md#a-stack-of-pictures) with the surface"""
    noise: ObservationNoise | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "ObservationFile":
        if sum(one is not None for one in (self.file, self.synthetic, self.image, self.stack)) != 1:
            raise ValueError("one of `file` with its `unit`, `image`, `stack` and `synthetic`")
        if self.file is None and self.reading:
            raise ValueError(f"`{next(iter(self.reading))}` only with a `file`, since it says how to read it")
        if self.file is not None and self.unit is None:
            raise ValueError("the unit of the coordinates too: `unit: mm` (or um, m)")
        if self.synthetic is None and self.noise is not None:
            raise ValueError(
                "`noise` with `synthetic` only: a file holds its own; σ_N stands under the study's `noise`"
            )
        return self

    @property
    def reading(self) -> dict[str, Any]:
        return {name: value for name in READ if (value := getattr(self, name)) is not None}


def _condition(name: str) -> str:
    if not name or not is_condition(name):
        raise ValueError("a short name without slashes")
    return name


class ConditionFile(ObservationFile):
    """The observed interface of one of several conditions."""

    condition: Annotated[str, AfterValidator(_condition)]
    """in a list only: the condition of this `file`"""

    @model_validator(mode="after")
    def _no_synthetic(self) -> "ConditionFile":
        if self.synthetic is not None:
            raise ValueError("a `file` for each condition; `observation: {synthetic: …}` observes all of them")
        return self


def _conditions(value: list[ConditionFile]) -> list[ConditionFile]:
    names = [item.condition for item in value]
    if len(set(names)) < len(names):
        raise ValueError("each condition once")
    return value


Observed = Annotated[
    Annotated[ObservationFile, Tag(ONE)]
    | Annotated[list[ConditionFile], Field(min_length=1), AfterValidator(_conditions), Tag(SEVERAL)],
    Discriminator(lambda value: SEVERAL if isinstance(value, list) else ONE),
]


NotNegative = Annotated[Number, Field(ge=0)]
COLUMN, IMAGE = "column", "image"  # words for `noise.sd`: the sds in a table, and those that a picture shows
Range = tuple[Number, Number]
Sd = Annotated[Number, Field(gt=0)] | Literal["unknown", "column", "image"] | Range
Length = NotNegative | Literal["unknown"] | Range


class Unknown(Section):
    """Errors that all points of an observed interface share."""

    shift: NotNegative = 0.0
    """standard deviation of the position of the whole interface along each axis, in `noise.unit`"""
    rotation: Annotated[NotNegative, Field(le=MOST["rotation"])] = 0.0
    """standard deviation of its rotation, degrees"""
    scale: Annotated[NotNegative, Field(le=MOST["scale"])] = 0.0
    """standard deviation of its scale, as a share: `0.005` for half a per cent"""
    offset: NotNegative = 0.0
    """standard deviation of a common offset along the normals, such as that of a threshold, in `noise.unit`"""
    shared: Switch = False
    """whether shift, rotation and scale are the same in all conditions, as with a fixed camera"""


class ConditionNoise(Section):
    """Noise of one condition: of the measure, or with a `unit` of the observed points."""

    variance: Annotated[Number, Field(gt=0)] | None = None
    """σ_N², in the unit of d² (mm²)"""
    sd: Sd | None = None
    """instead of `variance`: σ_N; or with `unit` the standard deviation of [an observed point](../how-to/noise.md);
    `unknown` or a range [low, high] lets the residuals decide, `column` takes those of `observation.sd`,
    `image` what the picture shows"""
    unit: Literal["mm", "um", "µm", "m"] | None = None
    """`mm`, `um`, `µm` or `m`: `sd` is that of an observed point along the normal; strandline derives the noise of
    every measure from it"""
    length: Length | None = None
    """correlation length of the points' errors along the interface, in `unit`, `unknown` or a range as for `sd`;
    default: 0, independent points"""
    unknown: Unknown | None = None
    model_error: Switch = False
    """whether the model may err by [a smooth offset](../how-to/experiment.md#a-smooth-offset-along-the-interface) of
    unknown size along the interface"""
    spread: list[Name] = []
    """inputs that may [differ between conditions](../how-to/experiment.md#an-input-that-differs-between-conditions) by
    an unknown amount"""

    @property
    def of_points(self) -> bool:
        return self.unit is not None

    @model_validator(mode="after")
    def _one_of_both(self) -> "ConditionNoise":
        if (self.variance is None) == (self.sd is None):
            raise ValueError("either `variance` or `sd`")
        if self.of_points and self.variance is not None:
            raise ValueError("`unit` goes with `sd`; a `variance` is already in the unit of d²")
        if not self.of_points and not isinstance(self.sd, float | None):
            sd = f"[{', '.join(f'{end:g}' for end in self.sd)}]" if isinstance(self.sd, tuple) else self.sd
            raise ValueError(f"`sd: {sd}` with the `unit` of the observed points: mm, um or m")
        for name in ("length", "unknown", "model_error", "spread"):
            if getattr(self, name) not in (None, False, []) and not self.of_points:
                raise ValueError(f"`{name}` with the `sd` of the observed points and its `unit`: mm, um or m")
        low, high = VARIANCES
        if isinstance(self.sd, float | None) and not low <= self.squared <= high:
            raise ValueError(f"a σ_N² from {low:g} to {high:g}, the square of σ_N: the likelihood overflows beyond")
        return self

    @property
    def squared(self) -> float:
        """σ_N²; infinite if σ_N is missing or its square overflows."""
        if self.variance is not None:
            return self.variance
        return self.sd**2 if isinstance(self.sd, float) and self.sd < 1e150 else float("inf")


class StudyNoise(ConditionNoise):
    """Noise of every condition without its own."""

    conditions: dict[str, ConditionNoise] = {}
    """the same keys for the condition NAME, in place of the others"""
