"""A study in the browser: its runs while they are made, its posterior, its interfaces, and what its assumptions do."""

from strandline.view.notebook import Shown, shown
from strandline.view.server import Server, serving

__all__ = ["Server", "Shown", "serving", "shown"]
