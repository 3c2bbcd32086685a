"""A page answers nobody but those who know its address, and who call it by its own name."""

from __future__ import annotations

import socket

import pytest

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.viewer.admission import Admission
from carosac_toolkit.viewer.page import Page
from tests.another_user import as_another_user, as_root

UPGRADE = (
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: viser-v1.1.1\r\n"
)


@pytest.fixture(scope="module")
def page():
    page = Page(load_robot("carosac"), "carosac", port=8660)
    yield page
    page.close()


def status(page, path, *, host=None, origin=None, websocket=False):
    """Return the HTTP status of a request."""
    port = page.server.get_port()
    lines = [f"GET {path} HTTP/1.1\r\nHost: {host or f'127.0.0.1:{port}'}\r\n"]
    lines += [f"Origin: {origin}\r\n"] if origin else []
    lines += [UPGRADE] if websocket else []
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as connection:
        connection.sendall("".join([*lines, "\r\n"]).encode())
        return int(connection.recv(100).split()[1])


def secret(page):
    return "/" + page.url.split("/", 3)[3]


def test_its_own_page_and_websocket_are_answered(page):
    own = f"http://127.0.0.1:{page.server.get_port()}"
    assert status(page, secret(page)) == 200
    assert status(page, secret(page).rstrip("/"), origin=own, websocket=True) == 101
    assert status(page, secret(page), host="localhost:9000") == 200  # as through ssh -L


@pytest.mark.parametrize("websocket", [False, True])
@as_root
def test_another_user_who_does_not_know_the_secret_is_refused(page, websocket):
    paths = ["/", "/index.html", "/" + "A" * 22, "/?" + secret(page), "//"]
    refusals = as_another_user(lambda: [status(page, x, websocket=websocket) for x in paths])
    assert refusals == [403] * len(paths)


@pytest.mark.parametrize("websocket", [False, True])
@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:9", "null"])
def test_a_page_of_another_site_is_refused(page, origin, websocket):
    assert status(page, secret(page), origin=origin, websocket=websocket) == 403


@pytest.mark.parametrize("websocket", [False, True])
def test_a_name_that_was_bound_to_this_machine_is_refused(page, websocket):
    rebound = {"host": "evil.example:8660", "origin": "http://evil.example:8660"}
    assert status(page, secret(page), **rebound, websocket=websocket) == 403


def test_a_page_for_the_network_answers_to_addresses_and_its_own_name():
    admission = Admission("0.0.0.0")
    assert admission.name == socket.gethostname()
    for host in ("192.0.2.1:8080", "[2001:db8::1]:8080", f"{socket.gethostname()}:8080"):
        assert admission.allows(admission.path, host, f"http://{host}")
    assert not admission.allows(admission.path, "evil.example:8080", None)
    assert not Admission("127.0.0.1").allows(admission.path, "127.0.0.1", None)


def test_a_server_that_cannot_be_guarded_is_refused():
    with pytest.raises(CarosacError, match="cannot be guarded"), Admission("::1").installed():
        pass
