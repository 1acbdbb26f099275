"""Fluid-biofilm interaction in a flow cell: monolithic quasi-steady ALE on NGSolve."""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.models.biofilm.cells.fields import write_vtu
    from strandline.models.biofilm.model import Biofilm
else:
    __getattr__ = door(__name__, __file__)
