"""The tasks of each part."""

from collections.abc import Callable, Iterator
from functools import partial

from verification.validation.active.accuracy import Course, s3, s5, s6
from verification.validation.active.stopping import Stopped, stopped

__all__ = ["start", "tasks"]

RULES = ("refined", "centre")


def tasks(
    part: str, seeds: int, criterion: str, quadrature: str | None = None
) -> Iterator[Callable[[], Course | Stopped]]:
    """Yield the tasks of a part; for s3 and s6 with only one quadrature if it is given."""
    rules = RULES if quadrature is None else (quadrature,)
    if part == "stopping":
        for seed in range(1, seeds + 1):
            yield partial(stopped, "S3", "refined", sensitivities=False, seed=seed)
            yield partial(stopped, "S3", "centre", sensitivities=True, seed=seed)
            yield partial(stopped, "S5", "refined", sensitivities=False, seed=seed)
        return
    for seed in range(1, seeds + 1):
        for gradients in (False, True):
            if part == "failing" and not gradients:
                for share in (0.1, 0.3):
                    yield partial(
                        s3, "refined", sensitivities=False, seed=seed, most=30, criterion=criterion, share=share
                    )
            for rule in rules if part in ("s3", "s6") else (("refined",) if part == "s5" else ()):
                common = {"sensitivities": gradients, "seed": seed, "criterion": criterion}
                if part == "s3":
                    yield partial(s3, rule, most=12 if gradients else 20, **common)  # type: ignore[arg-type]
                if part == "s5":
                    yield partial(s5, rule, most=30 if gradients else 60, **common)  # type: ignore[arg-type]
                if part == "s6":
                    size = {"batch": 4} | ({"first": 17, "most": 45} if gradients else {"first": 58, "most": 140})
                    yield partial(s6, rule, **common, **size)  # type: ignore[arg-type]


def start() -> None:
    """Prepare a worker."""
    import jax

    jax.config.update("jax_enable_x64", True)
