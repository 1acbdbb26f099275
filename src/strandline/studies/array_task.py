"""One job of a SLURM array for the model of a study: ``python -m strandline.studies.array_task STUDY BATCH NUMBER``."""

import sys
from pathlib import Path

from strandline.runs import run_task
from strandline.studies.keys.parse import parse_study
from strandline.studies.load.models import build_model


def main(arguments: list[str]) -> None:
    """Make run NUMBER of the batch in the folder BATCH with the model of the study in the folder STUDY."""
    study, folder, number = arguments
    home = Path(study)
    run_task(Path(folder), int(number), lambda: build_model(parse_study(home)[0].model, home))


if __name__ == "__main__":
    from strandline.studies.array_task import main as imported_main  # a model must not be pickled as part of __main__

    imported_main(sys.argv[1:])
