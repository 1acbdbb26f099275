"""A study in the browser: its runs while they are made, its posterior, its interfaces, and what its assumptions do.

In: a study folder. Out: a page on 127.0.0.1, whose panels are those of the report.
"""

from strandline.view.server import Server, serving, show

__all__ = ["Server", "serving", "show"]
