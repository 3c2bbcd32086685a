"""Admission to a page: a secret path in its address, and checks of Host and Origin.

Without the secret, another user of this machine cannot read or steer the page; Host and Origin
keep out pages of other sites in the user's own browser, even by DNS rebinding.
"""

from __future__ import annotations

import dataclasses
import ipaddress
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.local_peer import is_loopback

SECRET_BYTES = 16
ALL_ADDRESSES = ("0.0.0.0", "::")
_starting = threading.Lock()


class Admission:
    """Judge of the requests to one page.

    Attributes:
        path: Path at which the page is served, with its secret: ``/SECRET/``.
        name: Name or address of this machine for the address of the page.
    """

    def __init__(self, host: str) -> None:
        """Draw the secret.

        Args:
            host: Address at which the page is served. One that other machines can reach may be
                called by any IP address, which needs no name server, and by this machine's name.
        """
        self.path = f"/{secrets.token_urlsafe(SECRET_BYTES)}/"
        self._is_local = is_loopback(host)
        self.name = f"[{host}]" if ":" in host else host
        if host in ALL_ADDRESSES:
            self.name = socket.gethostname()
        self._names = {host.lower(), *(() if self._is_local else _own_names())}

    def allows(self, path: str, host: str, origin: str | None) -> bool:
        """Return whether a request may pass.

        Args:
            path: Its path; the one of the websocket lacks the last slash.
            host: Its header Host.
            origin: Its header Origin; None from a program that is no browser, and for the page.
        """
        has_secret = secrets.compare_digest(
            f"{path}/".encode()[: len(self.path)], self.path.encode()
        )
        same_origin = origin is None or origin.lower().partition("://")[2] == host.lower()
        return has_secret and same_origin and self._is_own_name(host)

    def _is_own_name(self, host: str) -> bool:
        """Return whether a Host header names this machine."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return is_loopback(name) or name in self._names or (not self._is_local and _is_ip(name))

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Judge the requests of the server that viser starts in the block.

        Raises:
            CarosacError: viser serves in a way that cannot be guarded.
        """
        from websockets.asyncio import server

        serve, guarded = server.serve, []

        def serve_guarded(*args: Any, process_request: Any, **options: Any) -> Any:
            guarded.append(True)
            return serve(*args, process_request=self._judging(process_request), **options)

        with _starting:
            server.serve = serve_guarded  # type: ignore[assignment,misc]
            try:
                yield
            finally:
                server.serve = serve  # type: ignore[misc]
        if not guarded:
            raise CarosacError("this version of viser cannot be guarded against other users")

    def _judging(self, answer: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return the answer of viser to requests that may pass, and a refusal to others."""

        def process_request(connection: Any, request: Any) -> Any:
            headers = request.headers
            if not self.allows(request.path, headers.get("Host", ""), headers.get("Origin")):
                return connection.respond(
                    HTTPStatus.FORBIDDEN, "open the address that carosac printed\n"
                )
            path = "/" + request.path[len(self.path) :]
            return answer(connection, dataclasses.replace(request, path=path))

        return process_request


def _own_names() -> set[str]:
    """Return the names of this machine."""
    return {socket.gethostname().lower(), socket.getfqdn().lower()}


def _is_ip(name: str) -> bool:
    """Return whether a name is an IP address."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
