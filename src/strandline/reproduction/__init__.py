"""The published study, whole: its examples run, compared with the true model, its claims judged, one page."""

from strandline.reproduction.evidence import STUDIES, Evidence, Plan
from strandline.reproduction.judgement import Claim
from strandline.reproduction.run import Reproduction, reproduce

__all__ = ["STUDIES", "Claim", "Evidence", "Plan", "Reproduction", "reproduce"]
