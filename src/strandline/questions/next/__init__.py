"""Which experiment should be made next?"""

from strandline.questions.next.next_experiment import NextExperiment, next_experiment

__all__ = ["NextExperiment", "next_experiment"]
