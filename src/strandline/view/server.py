"""The web server of the page: it answers on the loopback address, to whoever has the token."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from strandline.errors import ForwardModelError, InvalidInput, StrandlineError
from strandline.studies.study import Study
from strandline.view.assumptions import asked_by
from strandline.view.door import HEADERS, Door
from strandline.view.saving import save_as
from strandline.view.shapes import picture_png
from strandline.view.viewed import ViewedStudy

try:
    from tornado.httpserver import HTTPServer
    from tornado.iostream import StreamClosedError
    from tornado.web import Application, RequestHandler, StaticFileHandler
except ImportError as error:
    raise InvalidInput(
        "strandline view",
        value="tornado is not installed",
        expected="the packages of the extra `view`",
        remedy="Install them: pip install 'strandline[view]'",
    ) from error

__all__ = ["Server", "serving"]

PAGE = Path(__file__).parent / "page"
PAUSE = 0.5
"""Seconds between two looks at the ledger."""
KEEP_ALIVE = 15.0
"""Seconds after which a silent stream of events says that it is alive."""
LARGEST_BODY = 1 << 20
ADDRESS = "127.0.0.1"


class Server:
    """A study served to a browser on this machine.

    Args:
        study: The study.
        port: Port to listen on; 0 takes any free one.
        door: Who may see the page.

    Raises:
        InvalidInput: The port cannot be used.
    """

    def __init__(self, study: Study, *, port: int = 0, door: Door | None = None) -> None:
        self.viewed, self.door = ViewedStudy(study), door or Door()
        try:
            self._socket = socket.create_server((ADDRESS, port))
        except OSError as error:
            raise InvalidInput(
                "port",
                value=f"{port}: {error.strerror}",
                expected="a port that no other program uses",
                remedy="Choose another one, or leave out --port.",
            ) from None
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._stop: Callable[[], object] = lambda: None

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{ADDRESS}:{self.port}/{self.door.token}/"

    def run(self, started: Callable[[], None] = lambda: None) -> None:
        """Serve until `stop` is called, or Ctrl-C."""
        asyncio.run(self._serve(started))

    def stop(self) -> None:
        """End `run`, from any thread."""
        self._stop()

    async def _serve(self, started: Callable[[], None]) -> None:
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        self._stop = lambda: loop.call_soon_threadsafe(ended.set)
        desk = _Desk(self.viewed, self.door)
        server = HTTPServer(_application(desk), max_body_size=LARGEST_BODY)
        server.add_socket(self._socket)
        watching = [asyncio.create_task(desk.watch_runs()), asyncio.create_task(desk.watch_posterior())]
        started()
        try:
            await ended.wait()
        finally:
            self._stop = lambda: None
            for task in watching:
                task.cancel()
            server.stop()
            await desk.close()
            await server.close_all_connections()


@contextmanager
def serving(study: Study, *, port: int = 0) -> Iterator[Server]:
    """Serve a study in a thread of its own, and stop at the end.

    Args:
        study: The study.
        port: Port to listen on; 0 takes any free one.
    """
    server, ready = Server(study, port=port), threading.Event()
    thread = threading.Thread(target=server.run, args=(ready.set,), daemon=True)
    thread.start()
    ready.wait()
    try:
        yield server
    finally:
        server.stop()
        thread.join()


@dataclass
class _Desk:
    """What all requests share: the study, threads that do the work, and a bell that rings when something is new."""

    viewed: ViewedStudy
    door: Door
    rings: int = 0
    streams: int = 0
    closing: bool = False
    problem: str = ""
    _reading: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "ledger"))
    _answering: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(2, "answers"))
    _sampling: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "posterior"))
    _changed: asyncio.Condition = field(default_factory=asyncio.Condition)
    _state: dict[str, Any] = field(default_factory=dict)
    _stamp: tuple[Any, ...] = ()
    _rest_until: float = 0.0

    async def read(self, task: Callable[[], Any]) -> Any:
        """Do a task that reads the ledger; one at a time."""
        return await asyncio.get_running_loop().run_in_executor(self._reading, task)

    async def answer(self, task: Callable[[], Any]) -> Any:
        """Do a task that computes."""
        return await asyncio.get_running_loop().run_in_executor(self._answering, task)

    async def watch_runs(self) -> None:
        """Look at the ledger again and again, and ring when something is new."""
        while True:
            try:
                new = await self.read(self._look)
            except (StrandlineError, OSError) as error:
                new, self.problem = str(error) != self.problem, str(error)
            if new:
                await self.ring()
            await asyncio.sleep(PAUSE)

    def _look(self) -> bool:
        """Read what is new; return whether there is anything. A large ledger is not counted all the time."""
        self.viewed.feed.update()
        stamp, begun = self.viewed.stamp, time.monotonic()
        if (stamp == self._stamp and not self.problem) or begun < self._rest_until:
            return False
        state = self.viewed.state
        self._rest_until = time.monotonic() + time.monotonic() - begun
        new, self._state, self._stamp, self.problem = state != self._state, state, stamp, ""
        return new

    async def watch_posterior(self) -> None:
        """Compute the posterior again when there are enough new runs, or read it when the study has ended."""
        loop = asyncio.get_running_loop()
        while True:
            if await self.read(self.viewed.due):
                await loop.run_in_executor(self._sampling, self.viewed.refresh)
                await self.read(self._look)
                await self.ring()
            await asyncio.sleep(PAUSE)

    async def ring(self) -> None:
        """Wake all streams of events."""
        async with self._changed:
            self.rings += 1
            self._changed.notify_all()

    async def heard(self, rings: int) -> int:
        """Wait until the bell has rung since; return how often it has."""
        async with self._changed:
            try:
                await asyncio.wait_for(self._changed.wait_for(lambda: self.closing or self.rings > rings), KEEP_ALIVE)
            except TimeoutError:
                return rings
        return self.rings

    @property
    def state(self) -> dict[str, Any]:
        """The state at the last look, and what is wrong with the ledger."""
        return {**self._state, "problem": self.problem}

    async def close(self) -> None:
        """Let all streams of events end."""
        self.closing = True
        await self.ring()
        for _ in range(100):
            if not self.streams:
                break
            await asyncio.sleep(0.01)
        for some in (self._reading, self._answering, self._sampling):
            some.shutdown(wait=False, cancel_futures=True)


class _Guarded(RequestHandler):
    """A request that is answered only to whoever has the token."""

    def initialize(self, desk: _Desk) -> None:
        self.desk = desk

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.set_header("Cache-Control", "no-store")
        self.clear_header("Server")

    def prepare(self) -> None:
        request = self.request
        token = request.path.split("/")[1]
        why = self.desk.door.refusal(request.host, request.headers.get("Origin"), token)
        if why:
            self.set_status(403)
            self.finish({"error": why})

    def write_error(self, status_code: int, **given: Any) -> None:
        self.finish({"error": "there is no such page" if status_code == 404 else "the page has a fault; see the log"})

    async def told(self, task: Callable[[], Awaitable[Any]]) -> None:
        """Send the result of a task, or why there is none."""
        try:
            found = await task()
        except (InvalidInput, ForwardModelError, StrandlineError) as error:
            self.set_status(400)
            found = {"error": str(error)}
        if found is None:
            self.set_status(404)
            found = {"error": "there is no such run"}
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(found, allow_nan=False, separators=(",", ":")))

    def body(self) -> dict[str, Any]:
        """Return what was sent.

        Raises:
            InvalidInput: It is no JSON object.
        """
        try:
            found = json.loads(self.request.body or b"{}")
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise InvalidInput("request", value="no JSON object", expected="one", remedy="Use the page.")
        return found


class _Missing(_Guarded):
    """Any other path."""

    def prepare(self) -> None:
        super().prepare()
        if not self._finished:
            self.send_error(404)


class _Page(_Guarded):
    """The page itself; what it asks for lies below its own address, so that all requests carry the token."""

    def get(self) -> None:
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish((PAGE / "index.html").read_bytes())


class _Static(_Guarded, StaticFileHandler):
    """Scripts and styles of the page."""

    def initialize(self, desk: _Desk, path: str) -> None:  # type: ignore[override]
        _Guarded.initialize(self, desk)
        StaticFileHandler.initialize(self, path)


class _Ask(_Guarded):
    """Questions to the study, by name."""

    async def get(self, name: str) -> None:
        desk, viewed = self.desk, self.desk.viewed
        tasks: dict[str, Callable[[], Awaitable[Any]]] = {
            "study": lambda: desk.read(lambda: viewed.facts),
            "state": lambda: _now(desk.state),
            "runs": lambda: desk.read(lambda: viewed.feed.since(self._integer("since"))),
            "run": lambda: desk.read(lambda: viewed.run(self._integer("row"))),
            "posterior": lambda: desk.answer(lambda: viewed.posterior),
        }
        if name not in tasks:
            self.send_error(404)
            return
        await self.told(tasks[name])

    async def post(self, name: str) -> None:
        viewed = self.desk.viewed
        tasks: dict[str, Callable[[dict[str, Any]], Any]] = {
            "predict": lambda given: viewed.predict(given.get("inputs") or {}),
            "ask": lambda given: viewed.ask(given.get("assumptions") or {}, again=bool(given.get("again"))),
            "flow": lambda given: viewed.flow(given.get("inputs") or {}, str(given.get("condition") or "")),
            "save": lambda given: _saved(viewed.study, given),
        }
        if name not in tasks:
            self.send_error(404)
            return
        await self.told(lambda: self.desk.answer(lambda: tasks[name](self.body())))

    def _integer(self, name: str) -> int:
        text = self.get_query_argument(name, "0")
        if not text.isdecimal() or len(text) > 15:
            raise InvalidInput(name, value=text[:40], expected="a whole number", remedy="Use the page.")
        return int(text)


class _Picture(_Guarded):
    """The picture of a condition."""

    async def get(self) -> None:
        condition = self.get_query_argument("condition", "")
        found = await self.desk.answer(lambda: picture_png(self.desk.viewed.study, condition))
        if found is None:
            self.send_error(404)
            return
        self.set_header("Content-Type", "image/png")
        self.set_header("Cache-Control", "private, max-age=3600")
        self.finish(found)


class _Events(_Guarded):
    """A stream of server-sent events: the state, whenever something is new."""

    async def get(self) -> None:
        self.set_header("Content-Type", "text/event-stream")
        desk, rings = self.desk, -1
        desk.streams += 1
        try:
            while not desk.closing:
                new = desk.rings if rings < 0 else await desk.heard(rings)
                state = json.dumps(desk.state, allow_nan=False)
                self.write(f"data: {state}\n\n" if new != rings else ": alive\n\n")
                rings = new
                await self.flush()
        except StreamClosedError:
            return
        finally:
            desk.streams -= 1


async def _now(value: Any) -> Any:
    return value


def _saved(study: Study, given: dict[str, Any]) -> dict[str, Any]:
    """Write a new study with the assumptions that were sent."""
    folder = save_as(study, str(given.get("name") or ""), asked_by(given.get("assumptions") or {}, study))
    return {"folder": str(folder), "command": f"strandline run {folder}"}


def _application(desk: _Desk) -> Application:
    shared = {"desk": desk}
    return Application(
        [
            (r"/[^/]+/", _Page, shared),
            (r"/[^/]+/api/picture", _Picture, shared),
            (r"/[^/]+/api/([a-z]+)", _Ask, shared),
            (r"/[^/]+/events", _Events, shared),
            (r"/[^/]+/page/(.*)", _Static, {**shared, "path": str(PAGE)}),
        ],
        default_handler_class=_Missing,
        default_handler_args=shared,
        log_function=lambda handler: None,
    )
