"""Which model do the data prefer?"""

from strandline.questions.compare.study_comparison import StudyComparison, compare

__all__ = ["StudyComparison", "compare"]
