"""A door before viser, which lets anybody in: pages of other sites stay outside, and who has not the token.

On this machine alone, a browser must ask for this very address, not for another name or from another site's page.
Where other machines can come, the first request carries a token as ``/?token=...``, gets it back as a cookie and is
sent to ``/``. What comes otherwise gets one sentence and nothing of viser.
"""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import re
import secrets
import socket
import socketserver
import threading
from typing import Any
from urllib.parse import parse_qs

_LARGEST = 1 << 16  # bytes of a request's head
_PATIENCE = 10.0  # s for it to come
_BLOCK = 1 << 16
_LINE = re.compile(rb"([A-Z]+) (\S+) HTTP/1\.[01]")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address.

    Examples
    --------
    >>> [is_loopback(host) for host in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "192.168.0.7")]
    [True, True, True, False, False]
    """
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    with contextlib.suppress(OSError, UnicodeError):  # 127.1 is short for 127.0.0.1
        return ipaddress.ip_address(socket.inet_aton(host)).is_loopback
    return host.lower() == "localhost"


class Gate:
    """Listens at an address, and hands those who may come in on to a port of this machine.

    `token` is what guests of an open gate need; None of one that only this machine can reach.
    """

    def __init__(self, host: str, port: int, inner: int, *, is_open: bool) -> None:
        self.token = secrets.token_urlsafe(24) if is_open else None
        self._host = host
        self._live: set[socket.socket] = set()  # connections that go through
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        gate = self

        class Door(socketserver.BaseRequestHandler):
            """One connection."""

            def handle(self) -> None:
                """Let it in, or not; a connection that breaks is over."""
                with contextlib.suppress(OSError):
                    gate._answer(self.request, inner)

        class Server(socketserver.ThreadingTCPServer):
            """One thread a connection; what a stranger sends is no reason to say anything."""

            def handle_error(self, request: Any, client_address: Any) -> None:
                """Let the connection go."""

            address_family, allow_reuse_address, daemon_threads, block_on_close = family, True, True, False

        self._server = Server((host, port), Door)
        self.port: int = self._server.server_address[1]
        self._cookie = f"tspslam_{self.port}"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Listen no more, and end what goes through: viser would wait for it."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        for each in list(self._live):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def _answer(self, guest: socket.socket, inner: int) -> None:
        guest.settimeout(_PATIENCE)
        head, rest = _read_head(guest)
        found = _LINE.match(head)
        if found and self.token and found[1] == b"GET" and self._is_right(_token_in(found[2])):
            cookie = f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            _reply(guest, "303 See Other", "", f"Location: /\r\nSet-Cookie: {cookie}\r\n")
        elif found and _is_same_site(head) and self._is_known(head):
            guest.settimeout(None)
            with socket.create_connection(("127.0.0.1", inner)) as server:
                ends = {guest, server}
                self._live |= ends
                try:
                    server.sendall(head + rest)
                    _pump_both(guest, server)
                finally:
                    self._live -= ends
        else:
            _reply(guest, "403 Forbidden", "This viewer needs the whole address that tspslam printed.\n")

    def _is_known(self, head: bytes) -> bool:
        """Whether the cookie is there, or, without a token, the browser asks for this machine by a name of its own."""
        if self.token is not None:
            return self._is_right(_cookies(head).get(self._cookie, ""))
        names = {self._host, f"[{self._host}]", "127.0.0.1", "localhost", "[::1]"}
        return _headers(head, "host")[0].lower() in {f"{name.lower()}:{self.port}" for name in names}

    def _is_right(self, token: str) -> bool:
        return self.token is not None and hmac.compare_digest(token.encode(), self.token.encode())


def address_of(gate: Gate, host: str) -> str:
    """What to open."""
    named = socket.gethostname() if host in ("0.0.0.0", "::", "") else f"[{host}]" if ":" in host else host
    return f"http://{named}:{gate.port}" + (f"/?token={gate.token}" if gate.token else "")


def remarks_of(gate: Gate, host: str, asked: int) -> list[str]:
    """What to say before the address."""
    lines = [f"port {asked} is in use: {gate.port} serves"] if asked not in (0, gate.port) else []
    if gate.token:
        lines.append(
            f"warning: other machines can reach {host}; they need the token of the address, which goes unencrypted"
        )
    return lines


def _read_head(guest: socket.socket) -> tuple[bytes, bytes]:
    """The head of a request, with its empty line, and what came after it."""
    data = b""
    while b"\r\n\r\n" not in data and len(data) < _LARGEST:
        block = guest.recv(_BLOCK)
        if not block:
            break
        data += block
    head, line, rest = data.partition(b"\r\n\r\n")
    return head + line, rest


def _token_in(target: bytes) -> str:
    return parse_qs(target.decode("latin-1").partition("?")[2]).get("token", [""])[0]


def _headers(head: bytes, name: str) -> list[str]:
    lines = (line.partition(":") for line in head.decode("latin-1").split("\r\n")[1:])
    return [value.strip() for key, _, value in lines if key.strip().lower() == name]


def _cookies(head: bytes) -> dict[str, str]:
    pairs = (each.strip().partition("=") for line in _headers(head, "cookie") for each in line.split(";"))
    return {name: value for name, _, value in pairs}


def _is_same_site(head: bytes) -> bool:
    """Whether a page of this very address asks, where a browser says which page does."""
    origins, hosts = _headers(head, "origin"), _headers(head, "host")
    return len(hosts) == 1 and all(origin.partition("://")[2] == hosts[0] for origin in origins)


def _reply(guest: socket.socket, status: str, text: str, more: str = "") -> None:
    body = text.encode()
    head = f"HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {len(body)}\r\n"
    guest.sendall(f"{head}Connection: close\r\nCache-Control: no-store\r\n{more}\r\n".encode() + body)


def _pump_both(guest: socket.socket, server: socket.socket) -> None:
    """Carry bytes both ways until one side ends."""
    back = threading.Thread(target=_pump, args=(server, guest), daemon=True)
    back.start()
    _pump(guest, server)
    back.join()


def _pump(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while block := source.recv(_BLOCK):
            target.sendall(block)
    for each in (source, target):
        with contextlib.suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)
