"""The key `failures` of study.yaml."""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from strandline.studies.keys.scalars import MOST_RETRIES, Count, Number
from strandline.studies.keys.section import Section

__all__ = ["Failures", "Stop"]


def _action(value: Any) -> Any:
    """Return `continue`, `abort`, or the number of retries."""
    if value in ("continue", "abort"):
        return value
    times = value.get("retry") if isinstance(value, dict) and len(value) == 1 else None
    if isinstance(times, int) and not isinstance(times, bool) and 1 <= times <= MOST_RETRIES:
        return times
    raise ValueError(f"continue, abort, or {{retry: N}} with N from 1 to {MOST_RETRIES}")


class Stop(Section):
    """When a campaign is stopped because nearly all of its runs fail."""

    share: Annotated[Number, Field(gt=0, le=1)] = 0.95
    """share of failed runs that stops the study, above 0, at most 1; never: `failures: {stop: never}`"""
    after: Count = 20
    """… once this many are done"""


def _stop(value: Any) -> Any:
    """Return None for `never`, and refuse other words."""
    if isinstance(value, str):
        if value != "never":
            raise ValueError("never, or {share: 0.95, after: 20}")
        return None
    return value


class Failures(Section):
    """What is done about forward runs that fail, by kind or state."""

    kinds: dict[str, Annotated[str | int, BeforeValidator(_action)]] = {}
    """by kind or state of a [failed run](../how-to/when-runs-fail.md): `continue`, `abort` or `{retry: N}`"""
    stop: Annotated[Stop | None, BeforeValidator(_stop)] = Stop()
