"""The published study, whole: its examples run, compared with the true model, its claims judged, one page."""

from verification.reproduction.evidence import STUDIES, Evidence, Plan
from verification.reproduction.judgement import Claim
from verification.reproduction.run import Reproduction, reproduce

__all__ = ["STUDIES", "Claim", "Evidence", "Plan", "Reproduction", "reproduce"]
