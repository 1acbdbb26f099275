"""How does the posterior change with other assumptions?"""

from strandline.questions.what_if.study_what_if import StudyWhatIf, what_if

__all__ = ["StudyWhatIf", "what_if"]
