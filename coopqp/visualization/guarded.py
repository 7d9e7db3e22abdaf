"""The viewer's server answers its own pages only: requests with a foreign ``Host`` or ``Origin`` are refused.

Without this, any page in the same browser could read the run from the server (also by a name that its owner points to
this machine).
"""

from __future__ import annotations

import contextlib
import gzip
import http
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from coopqp.errors import CoopqpError

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_LOCK = threading.Lock()
#: Addresses of a page's own script and of its own socket on the server.
_SCRIPT, _SOCKET = "/coopqp.js", "/coopqp"


@dataclass(frozen=True)
class OwnScript:
    """A script of our own in the pages of a server, and what hears the socket that it opens at ``/coopqp``.

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

    def into(self, response: Any) -> Any:
        """The page with the script in its head."""
        body: bytes = response.body
        if response.headers.get("Content-Encoding") == "gzip":
            body = gzip.decompress(body)
        head, found, tail = body.partition(b"</head>")
        if not found:
            raise CoopqpError("the page of this version of viser has no head. Install viser 1.1.")
        return _response(head + b'<script src="' + _SCRIPT.encode() + b'"></script></head>' + tail, "text/html")

    def serving(self, inner: Callable[[Any], Awaitable[None]]) -> Callable[[Any], Awaitable[None]]:
        """What serves a connection: this one's own, or ``inner``."""

        async def serve(connection: Any) -> None:
            await (self.hear if connection.request.path == _SOCKET else inner)(connection)

        return serve


def _response(body: bytes, kind: str) -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    headers = Headers({"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))})
    return Response(http.HTTPStatus.OK, "OK", headers, body)


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


def _guard(inner: Callable[[Any, Any], Any] | None, host: str, script: OwnScript | None) -> Callable[[Any, Any], Any]:
    """``process_request`` of a server of websockets that refuses foreign requests before ``inner`` sees them."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    def process_request(connection: Any, request: Any) -> Any:
        here = connection.local_address
        names = frozenset({host.lower(), str(here[0]).lower(), socket.gethostname().lower(), *_LOOPBACK})
        try:  # a browser sends no header twice
            own = is_own(request.headers.get("Host"), request.headers.get("Origin"), names=names, port=int(here[1]))
        except LookupError:
            own = False
        if not own:
            return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", Headers(), b"This page is for its own address.\n")
        if script is None or request.headers.get("Upgrade"):
            return None if inner is None else inner(connection, request)
        own_answer = script.answer(request.path)
        if own_answer is not None or inner is None:
            return own_answer
        response = inner(connection, request)
        return script.into(response) if request.path.partition("?")[0] == "/" else response

    return process_request


@contextlib.contextmanager
def guarded_servers(host: str, script: OwnScript | None = None) -> Iterator[None]:
    """While this lasts, servers that viser starts get the guard, and a script of our own if there is one.

    Raises:
        CoopqpError: viser has started its server in another way, so nothing guards it.
    """
    import websockets.asyncio.server as server

    plain, guarded = server.serve, []

    def serve(handler: Any, *arguments: Any, process_request: Any = None, **options: Any) -> Any:
        if str(getattr(process_request, "__module__", "")).startswith("viser"):
            guarded.append(process_request)
            process_request = _guard(process_request, host, script)
            handler = handler if script is None else script.serving(handler)
        return plain(handler, *arguments, process_request=process_request, **options)

    with _LOCK:
        server.serve = serve  # type: ignore[misc,assignment]
        try:
            yield
        finally:
            server.serve = plain  # type: ignore[misc]
    if not guarded:
        raise CoopqpError("this version of viser cannot be kept from answering foreign pages. Install viser 1.1.")
