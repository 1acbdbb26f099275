"""The argument STUDY of the commands: a folder, which the shell completes to those that hold a study."""

from pathlib import Path

import click
from click.shell_completion import CompletionItem

__all__ = ["STUDY", "StudyFolder"]


class StudyFolder(click.Path):
    """A path whose completion suggests folders with a study.yaml; folders alone if none here begins like that."""

    name = "study"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the folders of studies that begin with what was typed."""
        head, _, start = incomplete.rpartition("/")
        shown = f"{head}/" if "/" in incomplete else ""
        try:
            folders = sorted(path for path in Path(shown or ".").iterdir() if path.name.startswith(start))
        except OSError:
            folders = []
        studies = [path.name for path in folders if (path / "study.yaml").is_file()]
        if studies:
            return [CompletionItem(f"{shown}{name}") for name in studies]
        return [CompletionItem(incomplete, type="dir")]


STUDY = StudyFolder(path_type=Path)
