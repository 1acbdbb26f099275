"""Study folders: the YAML schema, loading, running, results."""

from strandline.studies.run import Outcome, run_study
from strandline.studies.study import Study, load_study

__all__ = ["Outcome", "Study", "load_study", "run_study"]
