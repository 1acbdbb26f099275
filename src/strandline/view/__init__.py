"""A study in the browser: its runs while they are made, its posterior, its interfaces, and what its assumptions do."""

from strandline.view.server import NotebookPage, Server, serving, show

__all__ = ["NotebookPage", "Server", "serving", "show"]
