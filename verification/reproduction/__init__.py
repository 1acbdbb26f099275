"""Reproduce the published study: run its examples, compare with the true model, judge its claims, write one page."""

from verification.reproduction.evidence import STUDIES, Plan
from verification.reproduction.run import Reproduction, reproduce

__all__ = ["STUDIES", "Plan", "Reproduction", "reproduce"]
