"""Would the intervals of a study contain the truth as often as they should?"""

from strandline.questions.coverage.study_coverage import StudyCoverage, coverage

__all__ = ["StudyCoverage", "coverage"]
