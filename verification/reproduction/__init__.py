"""Reproduce the published study: run its examples, compare with the true model, judge its claims, write one page."""

from verification.reproduction.evidence import STUDIES, Evidence, Plan
from verification.reproduction.judgement import Claim
from verification.reproduction.run import Reproduction, reproduce

__all__ = ["STUDIES", "Claim", "Evidence", "Plan", "Reproduction", "reproduce"]
