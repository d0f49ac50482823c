"""The web server of the console."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import shlex
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from anyio import CapacityLimiter, to_thread
from plotly.offline import get_plotlyjs
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from kincal import __version__
from kincal.link import crc_text
from kincal.pages import theme
from kincal.review import parse_crc
from kincal_shared.errors import KincalError

from . import own, question
from .bench import Bench
from .desk import Desk, Words
from .dictionary import dictionary, of_error
from .geometry import Geometry
from .guard import Access, Guard
from .past import Past
from .picture import Cursor, Picture
from .shelf import FOLDER, READ, Shelf
from .sources import Playback, Recording
from .spaces import Spaces

STATIC = Path(__file__).resolve().parent / "static"
EVERY_S = 0.15  # between two looks for changes
BEAT_S = 1.0  # longest silence: a browser that hears nothing for three of them has lost the link
_PAGE_ROWS = 2_000
_DIGITS = 15  # of a number in a request
_ABORTS = 8  # ABORTs at once, each with a thread of its own
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
Plain = dict[str, Any]


@dataclass(frozen=True)
class Console:
    """What is served. desk: None where nothing can be sent (a recording); recording: instead of a live link;
    bench: the model workbench; recordings: where the link is recorded, in words; shelf: tables;
    spaces: search spaces; past: history."""

    source: str
    geometry: Geometry
    picture: Picture
    desk: Desk | None = None
    recording: Recording | None = None
    bench: Bench | None = None
    recordings: str = ""
    shelf: Shelf | None = None
    spaces: Spaces | None = None
    past: Past | None = None


def make_app(console: Console, access: Access) -> ASGIApp:
    """The application, behind its guard."""
    routes = [
        Route("/", _static("index.html")),
        Route("/style.css", _style),
        Route("/plotly.js", _plotly),
        *(Route(f"/{path.name}", _static(path.name)) for path in sorted(STATIC.glob("*.js"))),
        Route("/favicon.svg", _static("favicon.svg")),
        WebSocketRoute("/api/feed", _feed(console)),
        Route("/api/about", _answer(lambda _r: _about(console))),
        *(_past_routes(console.past) if console.past else ()),
        Route("/api/frame/{seq:int}", _frame(console)),
        Route("/api/rows", _answer(lambda r: _rows(console, r))),
        *_desk_routes(console),
        *(_bench_routes(console.bench, console) if console.bench else ()),
        *(_shelf_routes(console.shelf, console.desk) if console.shelf else ()),
        *(_space_routes(console.spaces) if console.spaces else ()),
    ]
    return Guard(
        Starlette(
            routes=routes,
            exception_handlers={KincalError: _refused, OSError: _medium, HTTPException: _not_asked_so},
        ),
        access,
    )


# ---- files


def _static(name: str) -> Callable[[Request], Awaitable[Response]]:
    path = STATIC / name

    async def serve(_request: Request) -> Response:
        return Response(path.read_bytes(), media_type=_TYPES[path.suffix])

    return serve


async def _style(_request: Request) -> Response:
    """The pages' colours and style sheet, then the console's own."""
    pages = Path(theme.__file__).parent / "templates" / "style.css"
    text = theme.css_colours() + pages.read_text("utf-8") + (STATIC / "console.css").read_text("utf-8")
    return Response(text, media_type="text/css")


@cache
def _plotly_bytes() -> bytes:
    return str(get_plotlyjs()).encode()


async def _plotly(_request: Request) -> Response:
    headers = {"cache-control": "private, max-age=86400"}
    return Response(_plotly_bytes(), media_type="text/javascript", headers=headers)


# ---- answers


def _answer(what: Callable[[Request], Any]) -> Callable[[Request], Awaitable[Response]]:
    """A route that answers with JSON what a function gives, off the event loop."""

    async def answer(request: Request) -> Response:
        return _json(await run_in_threadpool(what, request))

    return answer


def _json(content: Any, status: int = 200) -> Response:
    # "<" cannot be read as markup by whatever shows this
    text = json.dumps(_finite(content), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return Response(text, status, media_type="application/json")


def _finite(value: Any) -> Any:
    """The same without numbers that JSON has no word for: figures have NaN where nothing is known."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(inner) for inner in value]
    return value


async def _refused(_request: Request, error: Exception) -> Response:
    """An error of the library: what, where and what to do."""
    assert isinstance(error, KincalError)
    return JSONResponse({"ok": False, "text": of_error(error)}, 409)


async def _not_asked_so(_request: Request, error: Exception) -> Response:
    """A request that the server cannot read: as JSON too, because the pages show its text."""
    assert isinstance(error, HTTPException)
    return JSONResponse({"ok": False, "text": error.detail}, error.status_code)


def _frame(console: Console) -> Callable[[Request], Awaitable[Response]]:
    """A frame of the camera; a browser asks for those that it has the time to show."""

    async def answer(request: Request) -> Response:
        source = console.recording or console.picture
        data = await run_in_threadpool(source.jpeg, request.path_params["seq"])
        if data is None:
            raise HTTPException(404, "there is a newer frame, or none")
        return Response(data, media_type="image/jpeg", headers={"cache-control": "no-store"})

    return answer


async def _medium(_request: Request, error: Exception) -> Response:
    """A full or missing medium is no secret and no crash: the operator has to know."""
    name = getattr(error, "filename", None)
    text = f"{getattr(error, 'strerror', None) or error}" + (f": {name}" if name else "")
    return JSONResponse({"ok": False, "text": text}, 507)


def _about(console: Console) -> Plain:
    desk = console.desk
    if console.shelf is not None:
        console.shelf.adopt()
    return {
        "version": __version__,
        "source": console.source,
        "live": console.recording is None,
        "span_us": console.recording.span_us if console.recording else None,
        "dark": theme.DARK,
        "dictionary": dictionary(),
        "scene": console.geometry.scene,
        "why_no_key": desk.why_no_key if desk else "a recording takes no commands",
        "journal": str(desk.journal_path) if desk else "",
        "recordings": console.recordings,
        "bench": str(console.bench.folder) if console.bench else "",
    }


def _rows(console: Console, request: Request) -> list[Plain]:
    before = _number(request.query_params.get("before", console.picture.n_rows), "before")
    return console.picture.page(before, _PAGE_ROWS)


# ---- the feed


def _feed(console: Console) -> Callable[[WebSocket], Awaitable[None]]:
    async def feed(ws: WebSocket) -> None:
        await ws.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            if console.recording is not None:
                await _play(ws, Playback(console.recording, console.geometry))
            else:
                await _stream(ws, console.picture)

    return feed


async def _stream(ws: WebSocket, picture: Picture) -> None:
    """A snapshot, then changes; ends when the browser does."""
    gone = asyncio.create_task(_until_gone(ws))
    try:
        async for message in _messages(picture, gone):
            await ws.send_text(json.dumps(message, separators=(",", ":")))
    finally:
        gone.cancel()


async def _messages(picture: Picture, gone: asyncio.Task[None]) -> AsyncIterator[Plain]:
    message, cursor = picture.snapshot()
    yield message
    silent_s = 0.0
    while not gone.done():
        await asyncio.sleep(EVERY_S)
        silent_s += EVERY_S
        changes = picture.changes(cursor)
        if changes is not None:
            yield changes
        elif silent_s >= BEAT_S:
            yield {"kind": "beat", "now_s": picture.clock(), "t_us": picture.t_us}
        else:
            continue
        silent_s = 0.0


async def _until_gone(ws: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await ws.receive_text()


async def _play(ws: WebSocket, playback: Playback) -> None:
    """The picture at the times that the browser asks for, the end first."""
    t_us = playback.recording.span_us[1]
    while True:
        picture = await run_in_threadpool(playback.seek, t_us)
        message, _ = picture.snapshot()
        await ws.send_text(json.dumps({**message, "now_s": t_us * 1e-6}, separators=(",", ":")))
        t_us = _seek(await ws.receive_text(), t_us)


def _seek(asked: str, t_us: int) -> int:
    """The time that a browser asks for; the one before if it asks for none."""
    try:
        return _number(json.loads(asked)["seek_us"], "seek_us")
    except (ValueError, TypeError, KeyError, RecursionError, HTTPException):
        return t_us


# ---- the desk


def _desk_routes(console: Console) -> list[Route]:
    def route(path: str, what: Callable[[Desk, Plain, Request], Plain], once: bool = True) -> Route:
        commands = not path.endswith(("/seen", "/remark"))

        async def answer(request: Request) -> Response:
            desk = console.desk
            if desk is None:
                return _json({"ok": False, "text": "this is a recording: nothing can be sent"}, 409)
            body = await _body(request)
            act = lambda: what(desk, body, request)  # noqa: E731
            if not once:
                return _json(await to_thread.run_sync(act, limiter=aborts))
            about = _subject(request) if commands else ""
            return _json(
                await run_in_threadpool(desk.once, _text(body, "number"), act, _asked(request, body), about)
            )

        return Route(path, answer, methods=["POST"])

    aborts = CapacityLimiter(_ABORTS)  # the threads of everything else may all be waiting

    def words(body: Plain) -> Words:
        return Words(_text(body, "by"), _text(body, "why"))

    def crc(request: Request) -> str:
        """As the journal and the picture have it: another spelling would be another correction to them."""
        return crc_text(parse_crc(str(request.path_params["crc"])))

    def remark(desk: Desk, body: Plain, request: Request) -> Plain:
        line = _number(body.get("answers", 0), "answers")
        return desk.remark(crc(request), _text(body, "by"), _text(body, "text"), _text(body, "what"), line)

    def read(what: Callable[[Desk, Request], Any]) -> Callable[[Request], Any]:
        def answer(request: Request) -> Any:
            if console.desk is None:
                which = f" --crc {crc(request)}" if "crc" in request.path_params else ""
                todo = (
                    f"`kincal review show {shlex.quote(console.source)}{which}` shows it and writes its page"
                )
                raise HTTPException(409, f"a recording has no review here; {todo}")
            if console.shelf is not None:
                console.shelf.adopt()
            return what(console.desk, request)

        return answer

    return [
        route("/api/abort", lambda d, _b, _r: d.abort(), once=False),
        route("/api/start", lambda d, b, _r: d.start(_number(b.get("poses", 0), "poses"), words(b))),
        route("/api/rollback", lambda d, b, _r: d.rollback(_text(b, "crc"), words(b))),
        Route("/api/review/{crc}", _answer(read(lambda d, r: d.review(crc(r))))),
        Route("/api/review/{crc}/clearance", _answer(read(lambda d, r: d.clearance(crc(r))))),
        Route("/api/rollback/preview", _answer(read(lambda d, _r: d.rollback_preview()))),
        Route("/api/journal/missing", _answer(read(lambda d, _r: {"text": d.missing}))),
        Route("/api/journal", _answer(read(lambda d, _r: d.log()))),
        Route("/api/journal/version", _answer(read(lambda d, _r: d.journal_version()))),
        route("/api/review/{crc}/seen", lambda d, b, r: d.see(crc(r), _text(b, "by"), _text(b, "shown"))),
        route("/api/review/{crc}/remark", remark),
        *(
            route(
                f"/api/review/{{crc}}/{what}",
                lambda d, b, r, what=what: d.decide(what, crc(r), words(b), _text(b, "override")),  # type: ignore[misc]
            )
            for what in ("arm", "go", "reject")
        ),
    ]


def _shelf_routes(shelf: Shelf, desk: Desk | None) -> list[Route]:
    def kind(request: Request) -> str:
        return str(request.path_params["kind"])

    def post(path: str, what: Callable[[str, Plain], Plain]) -> Route:
        async def answer(request: Request) -> Response:
            body = await _body(request)
            if desk is None:
                return _json({"ok": False, "text": "this is a recording: nothing can be sent"}, 409)
            act = lambda: what(kind(request), body)  # noqa: E731
            number, asked = _text(body, "number"), _asked(request, body)
            return _json(await run_in_threadpool(desk.once, number, act, asked, _subject(request)))

        return Route(path, answer, methods=["POST"])

    def state() -> list[Plain]:
        shelf.adopt()
        return shelf.state()

    def send(kind: str, body: Plain) -> Plain:
        words = Words(_text(body, "by"), _text(body, "why"))
        return shelf.send(kind, _text(body, "crc"), words, _text(body, "of") or FOLDER)

    def activate(kind: str, body: Plain) -> Plain:
        return shelf.activate(kind, _text(body, "crc"), Words(_text(body, "by"), _text(body, "why")))

    return [
        Route("/api/candidates/{crc}", _answer(lambda r: shelf.candidates(str(r.path_params["crc"])))),
        Route("/api/tables", _answer(lambda _r: state())),
        Route("/api/tables/{kind}/values", _answer(lambda r: shelf.values(kind(r), _of(r)))),
        Route(
            "/api/tables/{kind}/difference",
            _answer(lambda r: shelf.difference(kind(r), _of(r), _of(r, "to", READ))),
        ),
        post("/api/tables/{kind}/read", lambda k, _b: shelf.read_back(k)),
        post("/api/tables/{kind}/send", send),
        post("/api/tables/{kind}/activate", activate),
    ]


def _of(request: Request, name: str = "of", otherwise: str = FOLDER) -> str:
    return request.query_params.get(name, otherwise)


def _space_routes(spaces: Spaces) -> list[Route]:
    def post(path: str, what: Callable[[Plain], Plain]) -> Route:
        async def answer(request: Request) -> Response:
            body = await _body(request)
            return _json(await run_in_threadpool(what, body))

        return Route(f"/api/space/{path}", answer, methods=["POST"])

    def change(body: Plain) -> Plain:
        values = body.get("values")
        if not isinstance(values, dict):
            raise HTTPException(400, "values are an object")
        return spaces.change(values)

    return [
        Route("/api/space", _answer(lambda _r: spaces.state())),
        Route("/api/space/candidates", _answer(lambda r: spaces.candidates(_of(r)))),
        Route("/api/space/explain/{n:int}", _answer(lambda r: spaces.explain(r.path_params["n"], _of(r)))),
        Route("/api/space/difference", _answer(lambda r: spaces.difference(_of(r), _of(r, "to", READ)))),
        Route("/api/space/description", _answer(lambda _r: spaces.description()), methods=["GET"]),
        Route("/api/space/answer/{what}", _answer(lambda r: spaces.answer(r.path_params["what"]))),
        Route("/api/space/file/{name}", _attached(lambda r: spaces.file(r.path_params["name"]))),
        post("description", change),
        post("anew", lambda _b: spaces.begin_anew()),
        post("run", lambda b: spaces.run(_text(b, "what"), _text(b, "of") or FOLDER)),
        post("cancel", lambda _b: spaces.work.cancel()),
    ]


def _attached(what: Callable[[Request], Path]) -> Callable[[Request], Awaitable[Response]]:
    """A route that answers with a file to keep."""

    async def answer(request: Request) -> Response:
        path = await run_in_threadpool(what, request)
        headers = {"content-disposition": f'attachment; filename="{path.name}"'}
        return Response(path.read_bytes(), media_type="application/octet-stream", headers=headers)

    return answer


def _bench_routes(bench: Bench, console: Console) -> list[Route]:
    def route(path: str, what: Callable[[Plain], Plain]) -> Route:
        async def answer(request: Request) -> Response:
            body = await _body(request)
            return _json(await run_in_threadpool(what, body))

        return Route(f"/api/bench/{path}", answer, methods=["POST"])

    async def upload(request: Request) -> Response:
        data = await request.body()
        return _json(await run_in_threadpool(bench.upload, request.query_params.get("name", ""), data))

    def form(body: Plain) -> Plain:
        values = body.get("values")
        if not isinstance(values, dict):
            raise HTTPException(400, "values are an object")
        return bench.form(values)

    def uplink(drop: list[str]) -> Plain:
        if console.shelf is None:
            raise HTTPException(409, "no tables")
        return question.uplink(bench, console.shelf, drop)

    file = _attached(lambda r: bench.file(r.path_params["what"], r.path_params["name"]))

    return [
        Route("/api/bench", _answer(lambda _r: bench.state())),
        Route("/api/bench/answer/{what}", _answer(lambda r: bench.answer(r.path_params["what"]))),
        Route("/api/bench/file/{what}/{name}", file),
        Route("/api/bench/upload", upload, methods=["POST"]),
        route("choose", lambda b: bench.choose(*(_text(b, k) if k in b else None for k in ("arm", "data")))),
        route(
            "effects",
            lambda b: bench.effects(_names(b, "effects"), _names(b, "without") if "without" in b else None),
        ),
        route("undo", lambda _b: bench.undo()),
        route("run", lambda b: bench.run(_text(b, "what"), _names(b, "alternatives"))),
        Route("/api/bench/own", _answer(lambda _r: {"sections": own.sections()}), methods=["GET"]),
        route("own", form),
        route("take", lambda b: question.take(bench, console.picture, _text(b, "crc"))),
        route("uplink", lambda b: uplink(_names(b, "drop"))),
        route("cancel", lambda _b: bench.cancel()),
    ]


def _past_routes(past: Past) -> list[Route]:
    return [Route("/api/history", _answer(lambda _r: past.page()))]


def _names(body: Plain, key: str) -> list[str]:
    names = body.get(key, [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise HTTPException(400, f"{key} is no list of names")
    return names


def _text(body: Plain, key: str) -> str:
    value = body.get(key, "")
    if not isinstance(value, str):
        raise HTTPException(400, f"{key} is no text")
    return value


def _asked(request: Request, body: Plain) -> str:
    """What a request says, to tell it from another one."""
    return f"{request.url.path} {json.dumps(body, sort_keys=True)}"


def _subject(request: Request) -> str:
    """What a request acts on: the correction, the kind of table, or flight itself."""
    return " ".join(str(x).casefold() for x in request.path_params.values()) or "flight"


def _number(value: Any, name: str) -> int:
    """A whole number of a request."""
    if isinstance(value, str) and len(value) <= _DIGITS and value.isdecimal():
        value = int(value)
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 10**_DIGITS:
        raise HTTPException(400, f"{name} is no whole number")
    return value


async def _body(request: Request) -> Plain:
    try:
        body = json.loads(await request.body() or b"{}")
    except (ValueError, RecursionError):
        raise HTTPException(400, "this is no JSON") from None
    if not isinstance(body, dict):
        raise HTTPException(400, "this is no object")
    return body


__all__ = ["Console", "Cursor", "make_app"]
