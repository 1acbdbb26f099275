"""How much of an input's box a figure shows."""

from strandline.posterior import Posterior

__all__ = ["shown_interval"]

TAIL = 0.002
MARGIN = 0.35
WHOLE_BOX_FROM = 0.75


def shown_interval(posterior: Posterior, name: str) -> tuple[float, float]:
    """Return the part of the design box that holds nearly all mass, with a margin; the box if that is most of it.

    A posterior that data have narrowed to a few per cent of the box would be a speck on axes that show the whole box.

    Args:
        posterior: The weighted draws.
        name: Name of the input.
    """
    box = posterior.space[name].interval
    index = posterior.space.names.index(name)
    first, last = (float(q) for q in posterior.quantiles([TAIL, 1.0 - TAIL])[:, index])
    margin = MARGIN * (last - first)
    low, high = max(box[0], first - margin), min(box[1], last + margin)
    narrow = low < high and high - low < WHOLE_BOX_FROM * (box[1] - box[0])
    return (low, high) if narrow else box
