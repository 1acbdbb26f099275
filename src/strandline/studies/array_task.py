"""One job of a SLURM array for the model of a study: ``python -m strandline.studies.array_task STUDY BATCH NUMBER``."""

import sys
from pathlib import Path

from strandline.models import ForwardModel
from strandline.runs import run_task
from strandline.studies.keys.parse import parse_study
from strandline.studies.load.models import build_model


def main(arguments: list[str]) -> None:
    """Make run NUMBER of the batch in the folder BATCH with the model of the study in the folder STUDY."""
    study, folder, number = arguments
    run_task(Path(folder), int(number), lambda: _model(Path(study)))


def _model(study: Path) -> ForwardModel:
    """Return the model that study.yaml names; `run_task` checks that it is the model of the batch."""
    content, _ = parse_study(study)
    return build_model(content.model, study)


if __name__ == "__main__":
    from strandline.studies.array_task import main as imported_main  # a model must not be pickled as part of __main__

    imported_main(sys.argv[1:])
