"""The web server of the page: it answers on the loopback address, to whoever has the token."""

import asyncio
import atexit
import html
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from strandline.errors import InvalidInput
from strandline.studies.study import Study
from strandline.view.viewed import ViewedStudy

try:
    from tornado.httpserver import HTTPServer
except ImportError as error:
    raise InvalidInput(
        "strandline view",
        value="tornado is not installed",
        expected="the packages of the extra `view`",
        remedy="Install them: pip install 'strandline[view]'",
    ) from error

from strandline.view.requests import Access, application  # after the check: it imports tornado too
from strandline.view.session import PATIENCE, Session

LARGEST_BODY = 1 << 20
ADDRESS = "127.0.0.1"


class Server:
    """A study served to a browser on this machine.

    Port 0 takes any free one. The first counts and the first posterior wait for some seconds until a page has got the
    runs.

    Raises:
        InvalidInput: The port cannot be used.
    """

    def __init__(self, study: Study, *, port: int = 0, patience: float = PATIENCE) -> None:
        self.viewed, self.access, self._patience = ViewedStudy(study), Access(), patience
        try:
            self._socket = socket.create_server((ADDRESS, port))
        except (OSError, OverflowError) as error:
            raise InvalidInput(
                "port",
                value=f"{port}: {os.strerror(error.errno) if isinstance(error, OSError) and error.errno else error}",
                expected="a port that no other program uses",
                remedy="Choose another one, or leave out --port.",
            ) from None
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self.is_serving = False
        self._stop: Callable[[], object] = lambda: None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{ADDRESS}:{self.port}/{self.access.token}/"

    def run(self, started: Callable[[], None] = lambda: None) -> None:
        """Serve until `stop` is called, or Ctrl-C."""
        asyncio.run(self._serve(started))

    def start(self) -> None:
        """Serve in a thread of its own, until `stop` is called."""
        ready = threading.Event()
        self._thread = threading.Thread(target=self.run, args=(ready.set,), daemon=True)
        self._thread.start()
        ready.wait()

    def stop(self) -> None:
        """End `run` from another thread, and wait for the thread of `start`."""
        self.is_serving = False
        self._stop()
        if self._thread is not None:
            self._thread.join()

    async def _serve(self, started: Callable[[], None]) -> None:
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        self._stop = lambda: loop.call_soon_threadsafe(ended.set)
        session = Session(self.viewed, self._patience)
        server = HTTPServer(application(session, self.access), max_body_size=LARGEST_BODY)
        server.add_socket(self._socket)
        watching = [asyncio.create_task(session.watch_runs()), asyncio.create_task(session.watch_posterior())]
        self.is_serving = True
        started()
        try:
            await ended.wait()
        finally:
            self._stop, self.is_serving = lambda: None, False
            for task in watching:
                task.cancel()
            server.stop()
            await session.close()
            await server.close_all_connections()


@contextmanager
def serving(study: Study, *, port: int = 0, patience: float = PATIENCE) -> Iterator[Server]:
    """Serve a study in a thread of its own, and stop at the end."""
    server = Server(study, port=port, patience=patience)
    server.start()
    try:
        yield server
    finally:
        server.stop()


@dataclass(frozen=True, eq=False)
class NotebookPage:
    """A page that is served as long as the notebook's kernel lives, or until `close`, with its height in pixels."""

    server: Server
    height: int

    def __repr__(self) -> str:
        address = f": {self.server.url}" if self.server.is_serving else ", closed"
        return f"<page of {self.server.viewed.study.name}{address}>"

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


def show(study: Study, *, height: int = 900) -> NotebookPage:
    """Show the page of a study below a cell of a notebook, so many pixels high, until the kernel ends."""
    server = Server(study)
    server.start()
    atexit.register(server.stop)
    return NotebookPage(server, height)
