"""The web server of the page: it answers on the loopback address, to whoever has the token."""

import asyncio
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from strandline.errors import InvalidInput
from strandline.studies.study import Study
from strandline.view.door import Door
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

from strandline.view.desk import PATIENCE, Desk
from strandline.view.requests import application  # after the check: it imports tornado too

__all__ = ["Server", "serving"]

LARGEST_BODY = 1 << 20
ADDRESS = "127.0.0.1"


class Server:
    """A study served to a browser on this machine.

    Args:
        study: The study.
        port: Port to listen on; 0 takes any free one.
        door: Who may see the page.
        patience: Seconds for which the first counts and the first posterior wait until a page has got the runs.

    Raises:
        InvalidInput: The port cannot be used.
    """

    def __init__(self, study: Study, *, port: int = 0, door: Door | None = None, patience: float = PATIENCE) -> None:
        self.viewed, self.door, self._patience = ViewedStudy(study), door or Door(), patience
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
        self._stop: Callable[[], object] = lambda: None
        self._serving = False

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{ADDRESS}:{self.port}/{self.door.token}/"

    @property
    def is_serving(self) -> bool:
        """Whether the page answers."""
        return self._serving

    def run(self, started: Callable[[], None] = lambda: None) -> None:
        """Serve until `stop` is called, or Ctrl-C."""
        asyncio.run(self._serve(started))

    def stop(self) -> None:
        """End `run`, from any thread."""
        self._serving = False
        self._stop()

    async def _serve(self, started: Callable[[], None]) -> None:
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        self._stop = lambda: loop.call_soon_threadsafe(ended.set)
        desk = Desk(self.viewed, self.door, self._patience)
        server = HTTPServer(application(desk), max_body_size=LARGEST_BODY)
        server.add_socket(self._socket)
        watching = [asyncio.create_task(desk.watch_runs()), asyncio.create_task(desk.watch_posterior())]
        self._serving = True
        started()
        try:
            await ended.wait()
        finally:
            self._stop, self._serving = lambda: None, False
            for task in watching:
                task.cancel()
            server.stop()
            await desk.close()
            await server.close_all_connections()


@contextmanager
def serving(study: Study, *, port: int = 0, patience: float = PATIENCE) -> Iterator[Server]:
    """Serve a study in a thread of its own, and stop at the end.

    Args:
        study: The study.
        port: Port to listen on; 0 takes any free one.
        patience: Patience of the `Server`.
    """
    server, ready = Server(study, port=port, patience=patience), threading.Event()
    thread = threading.Thread(target=server.run, args=(ready.set,), daemon=True)
    thread.start()
    ready.wait()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
