"""Models whose process dies while it makes a run, or while it loads them; worker processes import this module."""

import os
import signal
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strandline.testing.models import SameResults


@dataclass(frozen=True)
class CrashesOnce(SameResults):
    """`base`, whose process dies the first time that inputs are run; `folder` remembers it."""

    folder: str

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        mark = Path(self.folder) / "-".join(value.hex() for _, value in sorted(inputs.items()))
        if not mark.exists():
            mark.touch()
            os._exit(3)
        return self.base(inputs, workdir)


@dataclass(frozen=True)
class KilledWhileLoading(SameResults):
    """`base`, whose process is killed while it loads the model, the first `times` times; `folder` keeps count."""

    folder: str
    times: int

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        for number in range(self.times):
            try:
                (Path(self.folder) / str(number)).touch(exist_ok=False)
            except FileExistsError:
                continue
            os.kill(os.getpid(), signal.SIGKILL)

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        return self.base(inputs, workdir)
