"""The viewer's server answers its own pages only: requests with a foreign ``Host`` or ``Origin`` are refused.

Without this, any page in the same browser could read the run from the server (also by a name that its owner points to
this machine).
"""

from __future__ import annotations

import contextlib
import http
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

from coopqp.errors import CoopqpError

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_LOCK = threading.Lock()


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


def _guard(inner: Callable[[Any, Any], Any] | None, host: str) -> Callable[[Any, Any], Any]:
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
        return None if inner is None else inner(connection, request)

    return process_request


@contextlib.contextmanager
def guarded_servers(host: str) -> Iterator[None]:
    """While this lasts, servers that viser starts get the guard.

    Raises:
        CoopqpError: viser has started its server in another way, so nothing guards it.
    """
    import websockets.asyncio.server as server

    plain, guarded = server.serve, []

    def serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        if str(getattr(process_request, "__module__", "")).startswith("viser"):
            guarded.append(process_request)
            process_request = _guard(process_request, host)
        return plain(*arguments, process_request=process_request, **options)

    with _LOCK:
        server.serve = serve  # type: ignore[misc,assignment]
        try:
            yield
        finally:
            server.serve = plain  # type: ignore[misc]
    if not guarded:
        raise CoopqpError("this version of viser cannot be kept from answering foreign pages. Install viser 1.1.")
