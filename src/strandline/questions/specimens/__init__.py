"""Many specimens and one study: a posterior for each, and the population."""

from strandline.questions.specimens.opened import Specimens, open_specimens
from strandline.questions.specimens.study_specimens import StudySpecimens, specimens
from strandline.questions.specimens.watch import Arrived, watch_specimens

__all__ = ["Arrived", "Specimens", "StudySpecimens", "open_specimens", "specimens", "watch_specimens"]
