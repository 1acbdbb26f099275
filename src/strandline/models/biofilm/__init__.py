"""Fluid-biofilm interaction in a flow cell: monolithic quasi-steady ALE on NGSolve."""
