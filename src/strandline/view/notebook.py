"""The page of a study below a cell of a notebook."""

import atexit
import html
import threading
from dataclasses import dataclass

from strandline.studies.study import Study
from strandline.view.server import Server

__all__ = ["Shown", "shown"]


@dataclass(frozen=True, eq=False)
class Shown:
    """A page that is served as long as the notebook's kernel lives, or until `close`.

    Args:
        server: Its server.
        height: Height below the cell, pixels.
    """

    server: Server
    height: int

    def __repr__(self) -> str:
        if not self.server.is_serving:
            return f"<page of {self.server.viewed.study.name}, closed>"
        return f"<page of {self.server.viewed.study.name}: {self.server.url}>"

    def _repr_html_(self) -> str:
        if not self.server.is_serving:
            return f"<p>{html.escape(repr(self))}</p>"
        url, name = html.escape(self.server.url), html.escape(self.server.viewed.study.name)
        style = "border: 1px solid #8884; border-radius: 8px"
        return f'<iframe src="{url}" title="{name}" width="100%" height="{self.height}" style="{style}"></iframe>'

    def close(self) -> None:
        """Stop serving the page."""
        self.server.stop()
        atexit.unregister(self.server.stop)


def shown(study: Study, *, height: int = 900) -> Shown:
    """Serve the page of a study in a thread of its own.

    Args:
        study: The study.
        height: Height below the cell, pixels.
    """
    server, ready = Server(study), threading.Event()
    threading.Thread(target=server.run, args=(ready.set,), daemon=True).start()
    ready.wait()
    atexit.register(server.stop)
    return Shown(server, height)
