"""A study in the browser: its runs while they are made, its posterior, its interfaces, and what its assumptions do."""

from strandline.view.server import Server, serving, show

__all__ = ["Server", "serving", "show"]
