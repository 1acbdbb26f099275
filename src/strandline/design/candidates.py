"""Candidates for the next experiment: what they set, and what of the interface they observe."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product

Setting = Mapping[str, float]
"""Quantities that an experiment sets to other values than the present one; empty for the same experiment again."""
MICROMETRES = 1e3

TIMES = {2: "twice", 3: "three times"}
FEWEST_POINTS = 3  # smallest number of points that can be observed
WHOLE = (0.0, 1.0)  # the whole interface, as shares of its arc length


@dataclass(frozen=True)
class Look:
    """What of the interface is observed: the conditions, all if empty; where the observed part begins and ends, as
    shares of the present observation's arc length; number and standard deviation, mm, of the observed points, None for
    those of the present observation.
    """

    conditions: tuple[str, ...] = ()
    part: tuple[float, float] = WHOLE
    points: int | None = None
    sd: float | None = None

    @property
    def words(self) -> Iterator[str]:
        """What differs from the present observation, in words."""
        if self.part != WHOLE:
            yield f"{100 * self.part[0]:.3g}–{100 * self.part[1]:.3g} % of the interface"
        if self.points is not None:
            yield f"{self.points} points"
        if self.sd is not None:
            yield f"sd {MICROMETRES * self.sd:.3g} µm"


@dataclass(frozen=True)
class Candidate:
    """One or several experiments that are made together: the setting of each, and what is observed of all."""

    settings: tuple[Setting, ...]
    look: Look

    def label(self, present: str = "the same again") -> str:
        """Return the candidate in words, e.g. ``V_in 50 and V_in 125, 20 points``; `present` if no quantity is set."""
        conditions = " and ".join(self.look.conditions)
        kind = f"condition{'s' * (len(self.look.conditions) > 1)} {conditions}" if conditions else ""
        each = (" ".join(f"{name} {value:.6g}" for name, value in one.items()) for one in self.settings)
        settings = [one or kind or present for one in each]
        if len(settings) > 1 and not any(self.settings):
            settings = [f"{settings[0]}, {TIMES[len(settings)]}"]
        further = [kind] if kind and any(self.settings) else []
        return ", ".join([" and ".join(settings), *further, *self.look.words])


def key_of(setting: Setting) -> str:
    """Return a text that is the same for equal settings alone."""
    return repr(sorted(setting.items()))


def candidates(
    values: Mapping[str, Sequence[float]],
    looks: Iterable[Look],
    *,
    together: int = 1,
    present: Mapping[str, float] | None = None,
) -> tuple[Candidate, ...]:
    """Return all candidates: every combination of the values with every look, alone and up to so many `together`.

    `values` are those of each quantity that can be set; none is the same experiment again, as setting the values that
    the `present` one has. Experiments that are made together have the same look.
    """
    rows = [zip(values, row, strict=True) for row in product(*values.values())]
    changes = [{name: value for name, value in row if (present or {}).get(name) != value} for row in rows]
    settings = list({key_of(one): one for one in changes}.values())
    looks = tuple(dict.fromkeys(looks))
    return tuple(
        Candidate(several, look)
        for number in range(1, together + 1)
        for several in combinations_with_replacement(settings, number)
        for look in looks
    )
