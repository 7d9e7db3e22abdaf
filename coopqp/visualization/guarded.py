"""The viewer's server answers its own pages only: requests with a foreign ``Host`` or ``Origin`` are refused.

Without this, any page in the same browser could read the run from the server (also by a name that its owner points to
this machine). Its addresses begin with a key, which is new for each server: another program of this machine does not
know it. No page may show it in a frame, where a click could be led to a button of it.
"""

from __future__ import annotations

import contextlib
import http
import os
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from coopqp.errors import CoopqpError

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_LOCK = threading.Lock()
#: Addresses of a page's own script and of its own socket on the server, after the key.
_SCRIPT, _SOCKET = "/coopqp.js", "/coopqp"
#: What browsers are told with every answer. The address is for nobody else, as it has the key.
_HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class OwnScript:
    """A script of our own in the pages of a server, and what hears the socket that it opens at ``coopqp``.

    Attributes:
        text: the script, JavaScript.
        hear: serves one connection of websockets.
    """

    text: str
    hear: Callable[[Any], Awaitable[None]]

    def answer(self, path: str) -> Any:
        """The script, where it is asked for."""
        if path != _SCRIPT:
            return None
        return _response(self.text.encode(), "application/javascript")

    def into(self, response: Any, key: str) -> Any:
        """The page with the script in its head; the server's addresses begin with the key."""
        head, found, tail = response.body.partition(b"</head>")
        if not found:
            raise CoopqpError("the page of this version of viser has no head. Install viser 1.1.")
        return _response(head + f'<script src="/{key}{_SCRIPT}"></script></head>'.encode() + tail, "text/html")

    def serving(self, inner: Callable[[Any], Awaitable[None]]) -> Callable[[Any], Awaitable[None]]:
        """What serves a connection: this one's own, or ``inner``."""

        async def serve(connection: Any) -> None:
            await (self.hear if connection.request.path == _SOCKET else inner)(connection)

        return serve


def _response(body: bytes, kind: str, status: http.HTTPStatus = http.HTTPStatus.OK) -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    headers = Headers({"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)


def is_own(host: str | None, origin: str | None, *, names: frozenset[str], port: int) -> bool:
    """True if a request is for this server, and comes from its own page or from no page.

    Args:
        host, origin: headers of the request; None for a header that is missing.
        names: names and addresses of the server.
        port: its port.
    """
    return _names(f"//{host}", names, port) and (
        origin is None or (origin.startswith(("http://", "https://")) and _names(origin, names, port))
    )


def _names(address: str, names: frozenset[str], port: int) -> bool:
    try:
        parts = urlsplit(address)
        return parts.hostname in names and (parts.port or 80) == port
    except ValueError:  # no port, or brackets that do not close
        return False


def _below(path: str, key: str) -> str | None:
    """A request's path without the key that it begins with; None if it has another one."""
    found, _, rest = path.removeprefix("/").partition("/")
    found, mark, query = found.partition("?")
    return f"/{rest}{mark}{query}" if secrets.compare_digest(os.fsencode(found), os.fsencode(key)) else None


def _guard(
    inner: Callable[[Any, Any], Any] | None, host: str, key: str, script: OwnScript | None
) -> Callable[[Any, Any], Any]:
    """``process_request`` of a server of websockets that refuses foreign requests before ``inner`` sees them."""

    def answer(connection: Any, request: Any) -> Any:
        here = connection.local_address
        names = frozenset({host.lower(), str(here[0]).lower(), socket.gethostname().lower(), *_LOOPBACK})
        try:  # a browser sends no header twice
            own = is_own(request.headers.get("Host"), request.headers.get("Origin"), names=names, port=int(here[1]))
        except LookupError:
            own = False
        if not own:
            return _response(b"This page is for its own address.\n", "text/plain", http.HTTPStatus.FORBIDDEN)
        path = _below(request.path, key)
        if path is None:
            said = b"Open the whole address that the program tells: it has a key, which is new for each run.\n"
            return _response(said, "text/plain", http.HTTPStatus.FORBIDDEN)
        request.path = path  # what serves the connection sees it, too
        if script is None or request.headers.get("Upgrade"):
            return None if inner is None else inner(connection, request)
        own_answer = script.answer(path)
        if own_answer is not None or inner is None:
            return own_answer
        if path.partition("?")[0] != "/":
            return inner(connection, request)
        if "Accept-Encoding" in request.headers:
            del request.headers["Accept-Encoding"]  # the page is taken as it is
        return script.into(inner(connection, request), key)

    def process_request(connection: Any, request: Any) -> Any:
        response = answer(connection, request)
        if response is not None:
            for name, value in _HEADERS.items():
                response.headers[name] = value
        return response

    return process_request


@contextlib.contextmanager
def guarded_servers(host: str, script: OwnScript | None = None) -> Iterator[str]:
    """While this lasts, servers that viser starts get the guard, and a script of our own if there is one.

    Yields the key that their addresses begin with.

    Raises:
        CoopqpError: viser has started its server in another way, so nothing guards it.
    """
    import websockets.asyncio.server as server

    plain, guarded, key = server.serve, [], secrets.token_urlsafe(16)

    def serve(handler: Any, *arguments: Any, process_request: Any = None, **options: Any) -> Any:
        if str(getattr(process_request, "__module__", "")).startswith("viser"):
            guarded.append(process_request)
            process_request = _guard(process_request, host, key, script)
            handler = handler if script is None else script.serving(handler)
        return plain(handler, *arguments, process_request=process_request, **options)

    with _LOCK:
        server.serve = serve  # type: ignore[misc,assignment]
        try:
            yield key
        finally:
            server.serve = plain  # type: ignore[misc]
    if not guarded:
        raise CoopqpError("this version of viser cannot be kept from answering foreign pages. Install viser 1.1.")
