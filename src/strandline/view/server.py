"""The web server of the page: it answers on the loopback address, to whoever has the token.

A server on the loopback address is within reach of every web page that the user opens, and of every user of the
machine. A page whose domain points to this address (DNS rebinding) is recognised by its `Host`; other users do not know
the token.
"""

import asyncio
import atexit
import gc
import hmac
import html
import json
import os
import secrets
import socket
import threading
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from strandline.foundations import StrandlineError, require, unfit
from strandline.models.umbridge import Access
from strandline.report import PANELS, template
from strandline.studies import Study, picture_png
from strandline.view.assumptions import asked_by, save_as
from strandline.view.viewed import ViewedStudy

try:
    from tornado.httpserver import HTTPServer
    from tornado.iostream import StreamClosedError
    from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler, addslash
except ImportError as error:
    expected, remedy = "the packages of the extra `view`", "Install them: pip install 'strandline[view]'"
    raise unfit("strandline view", "tornado is not installed", expected, remedy) from error

PAUSE = 0.5
"""Seconds between two looks at the ledger."""
PATIENCE = 5.0
"""Seconds for which the first counts and the first posterior wait until a page has got the runs."""


@dataclass
class Session:
    """What all requests share: the study, threads that do the work, and the state at the last look.

    `streams` counts the open streams of events, which end when it is `closing`; `problem` says what is wrong with the
    ledger.
    """

    viewed: ViewedStudy
    patience: float = PATIENCE
    streams: int = 0
    closing: bool = False
    problem: str = ""
    _reading: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "ledger"))
    _answering: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(2, "answers"))
    _solving: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "flow"))
    _sampling: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "posterior"))
    _runs_given: asyncio.Event = field(default_factory=asyncio.Event)
    _counted: asyncio.Event = field(default_factory=asyncio.Event)
    _state: dict[str, Any] = field(default_factory=dict)
    _stamp: tuple[Any, ...] = ()
    _rest_until: float = 0.0

    async def read(self, task: Callable[[], Any]) -> Any:
        """Do a task that reads the ledger; one at a time."""
        return await _done(self._reading, partial(_without_collection, task))

    async def runs_since(self, version: int) -> dict[str, Any]:
        """Return the runs that changed after a version of the feed."""
        found: dict[str, Any] = await self.read(lambda: self.viewed.feed.since(version))
        self._runs_given.set()
        return found

    async def answer(self, task: Callable[[], Any]) -> Any:
        return await _done(self._answering, task)

    async def solve(self, task: Callable[[], Any]) -> Any:
        """Do a task that runs the model; one at a time."""
        return await _done(self._solving, task)

    async def watch_runs(self) -> None:
        """Look at the ledger again and again; at first, only for the runs."""
        with suppress(StrandlineError, OSError, TimeoutError):
            await self.read(self.viewed.feed.update)
            self._state = {"version": self.viewed.feed.version}
            await asyncio.wait_for(self._runs_given.wait(), self.patience)
        while True:
            try:
                await self.read(self._look)
            except (StrandlineError, OSError) as error:
                self.problem = str(error)
            self._counted.set()
            await asyncio.sleep(PAUSE)

    def _look(self) -> None:
        """Read what is new. A large ledger is not counted all the time."""
        self.viewed.require_ledger()
        self.viewed.feed.update()
        stamp, begun = self.viewed.stamp, time.monotonic()
        if (stamp == self._stamp and not self.problem) or begun < self._rest_until:
            return
        self._state = self.viewed.state
        self._rest_until = time.monotonic() + time.monotonic() - begun
        self._stamp, self.problem = stamp, ""

    async def watch_posterior(self) -> None:
        """Compute the posterior again when there are enough new runs, or read it when the study has ended."""
        newest = self.viewed.newest
        await self._counted.wait()
        while True:
            made = self.viewed.feed.succeeded
            try:
                if await self.read(partial(newest.due, made)):
                    await _done(self._sampling, partial(newest.refresh, made))
                    await self.read(self._look)
            except (StrandlineError, OSError):
                pass  # `watch_runs` reports what is wrong with the ledger
            await asyncio.sleep(PAUSE)

    @property
    def state(self) -> dict[str, Any]:
        """The state at the last look, and what is wrong with the ledger."""
        return {**self._state, "problem": self.problem}

    async def close(self) -> None:
        """Let all streams of events end."""
        self.closing = True
        for _ in range(100):
            if not self.streams:
                break
            await asyncio.sleep(0.01)
        for some in (self._reading, self._answering, self._solving, self._sampling):
            some.shutdown(wait=False, cancel_futures=True)


async def _done(pool: ThreadPoolExecutor, task: Callable[[], Any]) -> Any:
    return await asyncio.get_running_loop().run_in_executor(pool, task)


def _without_collection(task: Callable[[], Any]) -> Any:
    """Do a task with garbage collection paused: the many objects that it makes for a large ledger all stay."""
    gc.disable()
    try:
        return task()
    finally:
        gc.enable()


HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self' "
    "http://localhost:* http://127.0.0.1:*",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Headers of every answer: nothing is loaded from elsewhere, or kept."""
NO_PAGE = "there is no such page"
ERRORS = {403: NO_PAGE, 404: NO_PAGE, 405: "such requests are not answered", 413: "the request is too long"}
PAGE = Path(__file__).parent / "page"
TICK = 0.2
"""Seconds after which a stream of events looks at the state again."""


def refusal(host: str, origin: str | None, given: str, token: str) -> str:
    """Return why a request is refused, by its headers and the token that its address gives; empty if it is let in."""
    if not Access().is_called(host):
        return "this page is called by localhost or 127.0.0.1 only"
    if origin is not None and origin.partition("//")[2] != host:
        return "other web pages may not ask"
    if not hmac.compare_digest(given.encode(), token.encode()):
        return "this page needs the whole address that strandline view printed"
    return ""


class _Guarded(RequestHandler):
    """A request that is answered only to whoever has the token."""

    def initialize(self, session: Session, token: str) -> None:
        self.session, self.token = session, token

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self) -> None:
        """Refuse a request from another host or page, or without the page's token."""
        request = self.request
        why = refusal(request.host, request.headers.get("Origin"), request.path.split("/")[1], self.token)
        if why:
            self.set_status(403)
            self.finish({"error": why})

    def write_error(self, status_code: int, **given: Any) -> None:
        """Answer an error in words, without a traceback."""
        self.finish({"error": ERRORS.get(status_code, "the page has a fault; see the terminal of `strandline view`")})

    async def reply(self, task: Callable[[], Awaitable[Any]]) -> None:
        """Send the result of a task, or why there is none."""
        try:
            found = await task()
        except StrandlineError as error:
            self.set_status(400)
            found = {"error": str(error)}
        if found is None:
            self.set_status(404)
            found = {"error": "there is no such run"}
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(found, allow_nan=False, separators=(",", ":")))

    def body(self) -> dict[str, Any]:
        """Return what was sent; refuse what is no JSON object."""
        try:
            found = json.loads(self.request.body or b"{}")
        except ValueError:
            found = None
        require(isinstance(found, dict), "request", "no JSON object", "one", "Use the page.")
        return dict(found)


class _Missing(_Guarded):
    """Any other path."""

    def prepare(self) -> None:
        super().prepare()
        if not self._finished:
            raise HTTPError(404)


class _Page(_Guarded):
    """The page itself; what it asks for lies below its own address, so that all requests carry the token."""

    @addslash
    def get(self) -> None:
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(template("index.html.j2", package="strandline.view").render())


class _Static(_Guarded, StaticFileHandler):
    def initialize(self, path: str, **shared: Any) -> None:  # type: ignore[override]
        _Guarded.initialize(self, **shared)
        StaticFileHandler.initialize(self, path)


class _Ask(_Guarded):
    """Questions to the study, by name."""

    async def get(self, name: str) -> None:
        """Answer a question that only reads."""
        session, viewed = self.session, self.session.viewed
        tasks: dict[str, Callable[[], Awaitable[Any]]] = {
            "study": lambda: session.answer(lambda: viewed.facts),
            "state": lambda: session.answer(lambda: session.state),
            "runs": lambda: session.runs_since(self._integer("since")),
            "run": lambda: session.read(lambda: viewed.run(self._integer("row"))),
            "posterior": lambda: session.answer(lambda: viewed.posterior),
        }
        if name not in tasks:
            raise HTTPError(404)
        await self.reply(tasks[name])

    async def post(self, name: str) -> None:
        """Answer a question that computes or saves; a solution of the flow does not hold up the others."""
        viewed = self.session.viewed

        def save(given: dict[str, Any]) -> dict[str, Any]:
            asked = asked_by(_part(given, "assumptions"), viewed.study)
            folder = save_as(viewed.study, str(given.get("name") or ""), asked)
            return {"folder": str(folder), "command": f"strandline run {folder}"}

        tasks: dict[str, Callable[[dict[str, Any]], Any]] = {
            "predict": lambda given: viewed.predict(_part(given, "inputs")),
            "ask": lambda given: viewed.ask(_part(given, "assumptions"), again=bool(given.get("again"))),
            "flow": lambda given: viewed.flow(_part(given, "inputs"), str(given.get("condition") or "")),
            "save": save,
        }
        if name not in tasks:
            raise HTTPError(404)
        work = self.session.solve if name == "flow" else self.session.answer
        await self.reply(lambda: work(lambda: tasks[name](self.body())))

    def _integer(self, name: str) -> int:
        text = self.get_query_argument(name, "0")
        require(text.isdecimal() and len(text) <= 15, name, text[:40], "a whole number", "Use the page.")
        return int(text)


class _PictureHandler(_Guarded):
    async def get(self) -> None:
        condition = self.get_query_argument("condition", "")
        found = await self.session.answer(lambda: picture_png(self.session.viewed.study, condition))
        if found is None:
            raise HTTPError(404)
        self.set_header("Content-Type", "image/png")
        self.set_header("Cache-Control", "private, max-age=3600")
        self.finish(found)


class _Events(_Guarded):
    """A stream of server-sent events: the state, whenever something is new, until the page or the server closes."""

    async def get(self) -> None:
        self.set_header("Content-Type", "text/event-stream")
        session, told = self.session, ""
        session.streams += 1
        try:
            while not session.closing:
                state = json.dumps(session.state, allow_nan=False)
                self.write(f"data: {state}\n\n" if state != told else ": alive\n\n")  # fails if the page has gone
                told = state
                await self.flush()
                await asyncio.sleep(TICK)
        except (StreamClosedError, asyncio.CancelledError):
            return  # cancelled when the server stops: Tornado would complain that it cannot send an error any more
        finally:
            session.streams -= 1


def _part(given: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a part of a request, a JSON object; empty if it is missing."""
    found = given.get(name)
    require(found is None or isinstance(found, dict), name, found, "a JSON object", "Use the page.")
    return found or {}


def application(session: Session, token: str) -> Application:
    """Return the web application."""
    shared = {"session": session, "token": token}
    return Application(
        [
            (r"/[^/]+/?", _Page, shared),
            (r"/[^/]+/api/picture", _PictureHandler, shared),
            (r"/[^/]+/api/([a-z]+)", _Ask, shared),
            (r"/[^/]+/events", _Events, shared),
            (r"/[^/]+/page/(.*)", _Static, {**shared, "path": str(PAGE)}),
            (r"/[^/]+/panels/(.*)", _Static, {**shared, "path": str(PANELS)}),
        ],
        default_handler_class=_Missing,
        default_handler_args=shared,
        log_function=lambda handler: None,
    )


LARGEST_BODY = 1 << 20
ADDRESS = "127.0.0.1"


class Server:
    """A study served to a browser on this machine; in a notebook it shows as its page, `height` pixels high.

    Port 0 takes any free one. The first counts and the first posterior wait for some seconds until a page has got the
    runs.

    Raises:
        InvalidInput: The port cannot be used.
    """

    def __init__(self, study: Study, *, port: int = 0, patience: float = PATIENCE, height: int = 900) -> None:
        words = "an input that is no coefficient of a field", "Read the report, which shows fields."
        require(len(study.space.scalars) > 0, "inputs of the page", "fields alone", *words)
        self.viewed, self.token = ViewedStudy(study), secrets.token_urlsafe(24)
        self._patience, self._height = patience, height
        try:
            self._socket = socket.create_server((ADDRESS, port))
        except (OSError, OverflowError) as error:
            reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else error
            expected, remedy = "a port that no other program uses", "Choose another one, or leave out --port."
            raise unfit("port", f"{port}: {reason}", expected, remedy) from None
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self.is_serving = False
        self._stop: Callable[[], object] = lambda: None
        self._thread: threading.Thread | None = None

    def __repr__(self) -> str:
        return f"<page of {self.viewed.study.name}{f': {self.url}' if self.is_serving else ', closed'}>"

    def _repr_html_(self) -> str:
        if not self.is_serving:
            return f"<p>{html.escape(repr(self))}</p>"
        place = f'src="{html.escape(self.url)}" title="{html.escape(self.viewed.study.name)}"'
        style = "border: 1px solid #8884; border-radius: 8px"
        return f'<iframe {place} width="100%" height="{self._height}" style="{style}"></iframe>'

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{ADDRESS}:{self.port}/{self.token}/"

    def run(self, started: Callable[[], None] = lambda: None) -> None:
        """Serve until `close` is called, or Ctrl-C."""
        asyncio.run(self._serve(started))

    def start(self) -> "Server":
        """Serve in a thread of its own, until `close` is called."""
        ready = threading.Event()
        self._thread = threading.Thread(target=self.run, args=(ready.set,), daemon=True)
        self._thread.start()
        ready.wait()
        return self

    def close(self) -> None:
        """End `run` from another thread, and wait for the thread of `start`."""
        self.is_serving = False
        self._stop()
        if self._thread is not None:
            self._thread.join()

    async def _serve(self, started: Callable[[], None]) -> None:
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        self._stop = lambda: loop.call_soon_threadsafe(ended.set)
        session = Session(self.viewed, self._patience)
        server = HTTPServer(application(session, self.token), max_body_size=LARGEST_BODY)
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


def serving(study: Study, *, port: int = 0, patience: float = PATIENCE) -> closing[Server]:
    """Serve a study in a thread of its own, and stop at the end of a ``with`` block."""
    return closing(Server(study, port=port, patience=patience).start())


def show(study: Study, *, height: int = 900) -> Server:
    """Show the page of a study below a cell of a notebook, so many pixels high, until the kernel ends or `close`."""
    server = Server(study, height=height).start()
    atexit.register(server.close)
    return server
