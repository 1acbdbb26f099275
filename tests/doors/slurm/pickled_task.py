"""A job's command for tests: the model, any one, comes from a pickle that the test itself has written."""

import pickle
import sys
from pathlib import Path

from strandline.runs.executors.slurm_array import run_task

if __name__ == "__main__":
    model, folder, number = sys.argv[1:]
    run_task(Path(folder), int(number), lambda: pickle.loads(Path(model).read_bytes()))
