"""Results of `strandline what-if` beside full analyses of the changed studies, which make their own forward runs.

FOLDER holds the finished study studies/biofilm-uniform-active, or a copy of it. Each changed study is run in a folder
beside it and takes over its runs. With ``--publish`` the table goes into docs/results/accuracy.md.

    python -m verification.validation.what_if FOLDER [--publish]
"""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from verification.validation.tables import DOCS, Table, arguments, show, table, write_study

import strandline as sl
from strandline.calibration.what_if import AlternativePosterior

PAGE = DOCS / "results" / "accuracy.md"
QUESTIONS: Mapping[str, Mapping[str, Any]] = {
    "E normal, 350 ± 50 Pa": {"prior": {"E": {"normal": [350, 50]}}},
    "E flat in its logarithm": {"prior": {"E": {"loguniform": [100, 800]}}},
    "noise half as large": {"noise": {"variance": 0.000125}},
    "noise twice as large": {"noise": {"variance": 0.002}},
    "normal offset, points 10 µm": {"measure": "normal_offset", "noise": {"sd": 10, "unit": "um"}},
}


def _changed(folder: Path, number: int, question: Mapping[str, Any]) -> Path:
    """Write the study that a question is about into a folder beside the finished one, whose runs it takes over."""
    content = yaml.safe_load((folder / "study.yaml").read_text("utf-8")) | {"reuse": [f"../{folder.name}"]}
    for name, prior in question.get("prior", {}).items():
        content["inputs"][name] = {"prior": prior, "unit": "Pa", "box": [100, 800]}
    if "measure" in question:
        content["discrepancy"] = {question["measure"]: {}}
    content["noise"] = question.get("noise", content["noise"])
    return write_study(folder.with_name(f"{folder.name}-what-if-{number}"), content)


def _row(name: str, answer: AlternativePosterior, full: sl.Posterior, runs: int, names: tuple[str, ...]) -> tuple:
    draws = answer.draws
    cells = [name, "weights" if answer.by == "reweighting" else "new draws"]
    for i in range(len(names)):
        cells += [f"{draws.mean[i]:.3g} ± {draws.sd[i]:.2g}", f"{full.mean[i]:.3g} ± {full.sd[i]:.2g}"]
    apart = np.abs(draws.mean - full.mean) / full.sd
    return (*cells, float(apart.max()), float(np.abs(draws.sd / full.sd - 1).max()), runs)


def new_runs(study: sl.Study, calibration: sl.Calibration) -> int:
    """Return the number of runs of a calibration that the finished study does not have."""
    keys = [record.key for record in calibration.records]
    with sl.Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
        return len(set(keys) - set(ledger.latest(keys)))


def _rows(folder: Path) -> Iterator[tuple]:
    study = sl.load_study(folder)
    begun = time.perf_counter()
    asked = [{**question, "name": name} for name, question in QUESTIONS.items()]
    answers = {one.alternative.name: one for one in sl.what_if(study, asked).found}
    print(f"what-if: {time.perf_counter() - begun:.1f} s", flush=True)
    for number, (name, question) in enumerate(QUESTIONS.items(), start=1):
        calibration = sl.run_study(sl.load_study(_changed(folder, number, question))).calibration
        yield _row(name, answers[name], calibration.posterior, new_runs(study, calibration), study.space.names)
        print(f"{name} done", flush=True)


def _compared(folder: Path) -> Table:
    by_input = [f"{name}, {way}" for name in sl.load_study(folder).space.names for way in ("what-if", "full")]
    heading = f"changed | by | {' | '.join(by_input)} | means apart, sd {{.2f}} | sd apart {{.0%}} | new runs {{d}}"
    return table("what_if", "what-if beside full analyses", heading, _rows(folder))


if __name__ == "__main__":
    given = arguments(__doc__, words="FOLDER", publish=False)
    show([_compared(Path(given.words[0]).resolve())], page=PAGE if given.publish else None)
