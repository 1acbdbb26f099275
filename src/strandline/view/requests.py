"""The requests of the page, and what they get."""

import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from tornado.iostream import StreamClosedError
from tornado.web import Application, RequestHandler, StaticFileHandler

from strandline.errors import InvalidInput, StrandlineError
from strandline.report import PANELS, template
from strandline.studies.pictures.shown import picture_png
from strandline.studies.study import Study
from strandline.view.assumptions import asked_by
from strandline.view.desk import Desk
from strandline.view.door import HEADERS
from strandline.view.saving import save_as

__all__ = ["application"]

ERRORS = {
    403: "there is no such page",
    404: "there is no such page",
    405: "such requests are not answered",
    413: "the request is too long",
}
PAGE = Path(__file__).parent / "page"


class _Guarded(RequestHandler):
    """A request that is answered only to whoever has the token."""

    def initialize(self, desk: Desk) -> None:
        """Keep what all requests share."""
        self.desk = desk

    def set_default_headers(self) -> None:
        """Forbid the browser to keep an answer, or to load anything from elsewhere."""
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.set_header("Cache-Control", "no-store")
        self.clear_header("Server")

    def prepare(self) -> None:
        """Refuse a request without the token, or from another page."""
        request = self.request
        token = request.path.split("/")[1]
        why = self.desk.door.refusal(request.host, request.headers.get("Origin"), token)
        if why:
            self.set_status(403)
            self.finish({"error": why})

    def write_error(self, status_code: int, **given: Any) -> None:
        """Answer an error in words, without a traceback."""
        self.finish({"error": ERRORS.get(status_code, "the page has a fault; see the terminal of `strandline view`")})

    async def told(self, task: Callable[[], Awaitable[Any]]) -> None:
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
        """Refuse it."""
        super().prepare()
        if not self._finished:
            self.send_error(404)


class _Page(_Guarded):
    """The page itself; what it asks for lies below its own address, so that all requests carry the token."""

    def get(self) -> None:
        """Send the page."""
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(template("index.html.j2", package="strandline.view").render())


class _WithoutSlash(_Guarded):
    """The address of the page without its last slash."""

    def get(self) -> None:
        """Send the browser there."""
        self.redirect(f"{self.request.path}/")


class _Static(_Guarded, StaticFileHandler):
    """Scripts and styles of the page."""

    def initialize(self, desk: Desk, path: str) -> None:  # type: ignore[override]
        """Keep what all requests share, and the folder of the files."""
        _Guarded.initialize(self, desk)
        StaticFileHandler.initialize(self, path)


class _Ask(_Guarded):
    """Questions to the study, by name."""

    async def get(self, name: str) -> None:
        """Answer a question that only reads."""
        desk, viewed = self.desk, self.desk.viewed
        tasks: dict[str, Callable[[], Awaitable[Any]]] = {
            "study": lambda: desk.answer(lambda: viewed.facts),
            "state": lambda: _now(desk.state),
            "runs": lambda: desk.runs_since(self._integer("since")),
            "run": lambda: desk.read(lambda: viewed.run(self._integer("row"))),
            "posterior": lambda: desk.answer(lambda: viewed.posterior),
        }
        if name not in tasks:
            self.send_error(404)
            return
        await self.told(tasks[name])

    async def post(self, name: str) -> None:
        """Answer a question that computes or saves; a solution of the flow does not hold up the others."""
        viewed = self.desk.viewed
        tasks: dict[str, Callable[[dict[str, Any]], Any]] = {
            "predict": lambda given: viewed.predict(_part(given, "inputs")),
            "ask": lambda given: viewed.ask(_part(given, "assumptions"), again=bool(given.get("again"))),
            "flow": lambda given: viewed.flow(_part(given, "inputs"), str(given.get("condition") or "")),
            "save": lambda given: _saved(viewed.study, given),
        }
        if name not in tasks:
            self.send_error(404)
            return
        work = self.desk.solve if name == "flow" else self.desk.answer
        await self.told(lambda: work(lambda: tasks[name](self.body())))

    def _integer(self, name: str) -> int:
        text = self.get_query_argument(name, "0")
        if not text.isdecimal() or len(text) > 15:
            raise InvalidInput(name, value=text[:40], expected="a whole number", remedy="Use the page.")
        return int(text)


class _Picture(_Guarded):
    """The picture of a condition."""

    async def get(self) -> None:
        """Send it as PNG."""
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
        """Send events until the page or the server closes."""
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


def _part(given: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a part of a request, a JSON object; empty if it is missing.

    Raises:
        InvalidInput: It is something else.
    """
    found = given.get(name)
    if found is not None and not isinstance(found, dict):
        raise InvalidInput(name, value=found, expected="a JSON object", remedy="Use the page.")
    return found or {}


async def _now(value: Any) -> Any:
    return value


def _saved(study: Study, given: dict[str, Any]) -> dict[str, Any]:
    """Write a new study with the assumptions that were sent."""
    folder = save_as(study, str(given.get("name") or ""), asked_by(_part(given, "assumptions"), study))
    return {"folder": str(folder), "command": f"strandline run {folder}"}


def application(desk: Desk) -> Application:
    """Return the web application.

    Args:
        desk: What all requests share.
    """
    shared = {"desk": desk}
    return Application(
        [
            (r"/[^/]+/", _Page, shared),
            (r"/[^/]+", _WithoutSlash, shared),
            (r"/[^/]+/api/picture", _Picture, shared),
            (r"/[^/]+/api/([a-z]+)", _Ask, shared),
            (r"/[^/]+/events", _Events, shared),
            (r"/[^/]+/page/(.*)", _Static, {**shared, "path": str(PAGE)}),
            (r"/[^/]+/panels/(.*)", _Static, {**shared, "path": str(PANELS)}),
        ],
        default_handler_class=_Missing,
        default_handler_args=shared,
        log_function=lambda handler: None,
    )
