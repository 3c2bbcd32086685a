import os
import socket
import sys
import threading
from contextlib import contextmanager

import pytest

from carosac_toolkit.base.local_peer import is_another_user, is_loopback, socket_owner
from tests.another_user import ANOTHER_UID, as_another_user, as_root

linux = pytest.mark.skipif(sys.platform != "linux", reason="the system does not tell")


@pytest.fixture(params=["127.0.0.1", "::1"])
def server(request):
    with socket.create_server((request.param, 0), family=family(request.param)) as server:
        yield server


@contextmanager
def in_thread(function):
    thread = threading.Thread(target=function)
    thread.start()
    yield
    thread.join()


def family(host):
    return socket.AF_INET6 if ":" in host else socket.AF_INET


@linux
@pytest.mark.parametrize("netlink", [True, False])
def test_a_tcp_peer_is_known_by_both_ends_of_its_connection(server, netlink, monkeypatch):
    if not netlink:  # as in some containers
        monkeypatch.setattr("carosac_toolkit.base.local_peer._messages", lambda *asked: iter(()))
    with socket.socket(server.family) as client:
        client.connect(server.getsockname())
        accepted, peer = server.accept()
        with accepted:
            there, here = peer[:2], accepted.getsockname()[:2]
            assert socket_owner("tcp", there, here) == os.geteuid()
            assert not is_another_user("tcp", there, here)
            assert socket_owner("tcp", there, (here[0], here[1] ^ 1)) is None


@linux
@as_root
def test_another_user_is_seen_over_tcp(server):
    def connect():
        with socket.socket(server.family) as client:
            client.connect(server.getsockname())
            return client.recv(1)

    def judge():
        accepted, peer = server.accept()
        with accepted:
            ends = peer[:2], accepted.getsockname()[:2]
            verdicts.append((socket_owner("tcp", *ends), is_another_user("tcp", *ends)))

    verdicts = []
    with in_thread(judge):
        as_another_user(connect)
    assert verdicts == [(ANOTHER_UID, True)]


@linux
def test_a_loopback_peer_that_has_closed_its_socket_counts_as_another_user(server):
    with socket.socket(server.family) as client:
        client.connect(server.getsockname())
    accepted, peer = server.accept()
    with accepted:
        ends = peer[:2], accepted.getsockname()[:2]
        assert socket_owner("tcp", *ends) is None and is_another_user("tcp", *ends)


@linux
@as_root
@pytest.mark.parametrize("bound", ["127.0.0.1", "0.0.0.0"])
def test_another_user_is_seen_over_udp(bound):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))

        def send():
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.bind((bound, 0))
                sender.connect(listener.getsockname())
                sender.send(b"here")
                return sender.recv(1)

        def judge():
            _, peer = listener.recvfrom(10)
            verdicts.append((socket_owner("udp", peer), is_another_user("udp", peer)))
            listener.sendto(b"x", peer)

        verdicts = []
        with in_thread(judge):
            as_another_user(send)
    assert verdicts == [(ANOTHER_UID, True)]


@contextmanager
def bound_by_another_user(family, host, port, *options):
    """A UDP socket of another user, with options that are set."""
    made = []
    here, there = socket.socketpair()

    def hold():
        with socket.socket(family, socket.SOCK_DGRAM) as other:
            for level, name in options:
                other.setsockopt(level, name, 1)
            other.bind((host, port))
            there.send(b"x")
            there.recv(1)

    with in_thread(lambda: made.append(as_another_user(hold))):
        here.settimeout(5.0)
        try:
            assert here.recv(1)
            yield
        finally:
            here.send(b"x")
    assert made == [None]
    here.close()
    there.close()


@linux
@as_root
@pytest.mark.parametrize("bound", ["127.0.0.1", "0.0.0.0"])
def test_a_socket_for_ipv6_alone_hides_no_sender_of_ipv4(bound):
    only = (socket.IPPROTO_IPV6, socket.IPV6_V6ONLY)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind((bound, 0))
        peer = ("127.0.0.1", sender.getsockname()[1])
        with bound_by_another_user(socket.AF_INET6, "::", peer[1], only):
            assert socket_owner("udp", peer) == os.geteuid()
            assert not is_another_user("udp", peer)
    with bound_by_another_user(socket.AF_INET6, "::", peer[1], only):
        assert is_another_user("udp", peer)


@linux
@as_root
@pytest.mark.parametrize("netlink", [True, False])
def test_two_sockets_that_can_both_send_from_an_address_have_no_owner(netlink, monkeypatch):
    if not netlink:  # then nobody can tell what the one of IPv6 can do
        monkeypatch.setattr("carosac_toolkit.base.local_peer._messages", lambda *asked: iter(()))
    shared = (socket.SOL_SOCKET, socket.SO_REUSEADDR)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(*shared, 1)
        sender.bind(("0.0.0.0", 0))
        peer = ("127.0.0.1", sender.getsockname()[1])
        with bound_by_another_user(socket.AF_INET6, "::", peer[1], shared):
            assert socket_owner("udp", peer) is None
            assert is_another_user("udp", peer)


@linux
@as_root
@pytest.mark.parametrize(("family", "host"), [(socket.AF_INET, "0.0.0.0"), (socket.AF_INET6, "::")])
def test_a_socket_of_another_user_is_not_one_on_another_machine(family, host):
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.bind((host, 0))
        port = probe.getsockname()[1]
    with bound_by_another_user(family, host, port):
        assert not is_another_user("udp", ("192.0.2.1", port))
        assert is_another_user("udp", ("127.0.0.1", port))


@linux
def test_a_datagram_of_this_user_is_its_own():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("0.0.0.0", 0))
        peer = ("127.0.0.1", sender.getsockname()[1])
        assert socket_owner("udp", peer) == os.geteuid()
        assert not is_another_user("udp", peer)


def test_a_peer_on_another_machine_is_no_user_of_this_one():
    assert socket_owner("udp", ("192.0.2.1", 9)) is None  # reserved for documentation
    assert not is_another_user("udp", ("192.0.2.1", 9))


def test_loopback_addresses():
    for host in ("127.0.0.1", "127.8.0.1", "::1", "localhost", "::ffff:127.0.0.1"):
        assert is_loopback(host)
    for host in ("0.0.0.0", "192.168.1.4", "::", "robot.example"):
        assert not is_loopback(host)
