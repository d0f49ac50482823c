"""Who may ask the console, checked before anything else of a request is looked at.

A server on the loopback address can be reached by every page that the browser of this machine shows: by its
address, or by a name that an attacker lets point there (DNS rebinding). So: a fixed list of names in the Host
header; a token, which the start address carries once and a cookie afterwards; and for everything that is more
than reading, an Origin header of this console and a content type that no form can send."""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
READING = ("GET", "HEAD")
TYPES = ("application/json", "application/octet-stream")  # a form can send neither
MOST_BYTES = 64 << 20
_LENGTH_DIGITS = 18
_REFUSED = 400
_TOKEN_BYTES = 24
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self'; font-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


@dataclass(frozen=True)
class Access:
    """port: the console's; names: by which it may be called; token: that the start address carries."""

    port: int
    names: tuple[str, ...] = LOOPBACK
    token: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES), repr=False)

    @property
    def hosts(self) -> frozenset[str]:
        """Values of the Host header that are taken."""
        return frozenset(f"{name}:{self.port}" for name in self.names)

    @property
    def origins(self) -> frozenset[str]:
        """Values of the Origin header that are taken."""
        return frozenset(f"http://{host}" for host in self.hosts)

    @property
    def cookie(self) -> str:
        """Name of the cookie: browsers do not keep those of two ports apart."""
        return f"kincal_{self.port}"

    @property
    def start(self) -> str:
        """The address to open."""
        return f"http://{self.names[0]}:{self.port}/?token={self.token}"


class Guard:
    """ASGI middleware: refuses everything that is not from a browser that was given the token."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self.app, self.access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request or WebSocket."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = _headers(scope["headers"])
        if scope["type"] == "websocket":
            if self._why_not(headers, changes=True):
                await send({"type": "websocket.close", "code": 1008, "reason": "refused"})
                return
            await self.app(scope, receive, send)
            return
        answer = self._answer(scope, headers)
        out = _with_headers(send)
        if answer is not None and answer.status_code >= _REFUSED:
            answer.headers["connection"] = "close"  # who has no token keeps no connection
        await (answer or self.app)(scope, receive, out)

    def _answer(self, scope: Scope, headers: Mapping[str, str]) -> Response | None:
        """A refusal, or the answer to the start address; None: go on."""
        changes = scope["method"] not in READING
        if headers.get("host") not in self.access.hosts:
            return PlainTextResponse("this console is not called by that name\n", 421)
        if not changes and scope["path"] == "/" and self._starts(scope):
            response = RedirectResponse("/", 303)
            response.set_cookie(self.access.cookie, self.access.token, httponly=True, samesite="strict")
            return response
        if why := self._why_not(headers, changes):
            return PlainTextResponse(f"{why}\n", 403)
        if changes and headers.get("content-type", "").partition(";")[0].strip() not in TYPES:
            return PlainTextResponse("this is not sent by a form\n", 415)
        length = headers.get("content-length", "")
        if changes and not length.isdecimal():
            return PlainTextResponse("the length of the content is missing\n", 411)
        if changes and (len(length) > _LENGTH_DIGITS or int(length) > MOST_BYTES):
            return PlainTextResponse(f"more than {MOST_BYTES >> 20} MB\n", 413)
        return None

    def _why_not(self, headers: Mapping[str, str], changes: bool) -> str:
        if headers.get("host") not in self.access.hosts:
            return "this console is not called by that name"
        if changes and headers.get("origin") not in self.access.origins:
            return "this request comes from another page"
        if not _same(_cookie(headers, self.access.cookie), self.access.token):
            return "open the address that `kincal serve` printed: it carries the token"
        return ""

    def _starts(self, scope: Scope) -> bool:
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])
        return _same(given[0], self.access.token)


def _headers(raw: Iterable[tuple[bytes, bytes]]) -> dict[str, str]:
    """By name; a name that comes twice has no value: which of the two would count?"""
    out: dict[str, str] = {}
    for name, value in raw:
        key = name.decode("latin-1").lower()
        out[key] = "" if key in out else value.decode("latin-1")
    return out


def _cookie(headers: Mapping[str, str], name: str) -> str:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(name)
    except CookieError:
        return ""
    return found.value if found else ""


def _same(given: str, token: str) -> bool:
    return secrets.compare_digest(given.encode(), token.encode())


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            there: list[Any] = list(message.get("headers", []))
            names = {name.lower() for name, _ in there}
            there += [
                (name.encode(), value.encode())
                for name, value in _HEADERS.items()
                if name.encode() not in names
            ]
            message = {**message, "headers": there}
        await send(message)

    return sending
