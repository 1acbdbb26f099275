"""Display of a posterior at a prompt and in a notebook: one line or one table."""

import html
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from strandline.parameters import ParameterSpace
from strandline.text import with_sd
from strandline.typeset import html_table, html_text, unit_text

__all__ = ["moments_line", "moments_table"]

MOST_SHOWN = 8
"""Inputs named in one line."""


def moments_line(space: ParameterSpace, mean: Float[np.ndarray, " dim"], sd: Float[np.ndarray, " dim"]) -> str:
    """Return ``E = 399.6 ± 15 Pa, nu = 0.297 ± 0.059``."""
    rows = zip(space, mean.tolist(), sd.tolist(), strict=True)
    parts = [f"{p.name} = {with_sd(middle, width)} {unit_text(p.unit)}".rstrip() for p, middle, width in rows]
    more = f", and {len(parts) - MOST_SHOWN} more" if len(parts) > MOST_SHOWN else ""
    return ", ".join(parts[:MOST_SHOWN]) + more


def moments_table(space: ParameterSpace, columns: Mapping[str, Float[np.ndarray, " dim"]]) -> str:
    """Return an HTML table with one row per input and one column per named quantity."""
    rows = [
        (html_text(parameter.name), html.escape(unit_text(parameter.unit)), *(f"{c[i]:.4g}" for c in columns.values()))
        for i, parameter in enumerate(space)
    ]
    return html_table(("input", "unit", *columns), rows)
