"""viser, started on this machine alone, silent, and without its way out of it."""

from __future__ import annotations

import os
import socket
from typing import Any

from ..._files import one_line
from ...errors import InputError, OutputError

MISSING = "the viewer needs viser, which is not installed: pip install 'tspslam[viewer]'"
TRIED = 100  # ports after the one that was asked for


def start_server(host: str, port: int) -> Any:
    """Start viser on the first free port from `port` on; 0 is any."""
    try:
        import rich
        import viser
    except ImportError as error:
        raise InputError(MISSING) from error
    rich.reconfigure(quiet=True)  # viser prints a table, and its farewell, on stdout
    os.environ.pop("_VISER_PORT_OVERRIDE", None)

    class Server(viser.ViserServer):  # type: ignore[misc]
        """One that no page can ask to be reachable from outside."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Refuse: viser would open a tunnel to a server of its makers."""

    return Server(host=host, port=free_port(host, port), verbose=False)


def free_port(host: str, port: int) -> int:
    """The first port from `port` on that nobody listens on; `InputError` if the host is none of this machine's."""
    for tried in range(port, min(port + TRIED, 65536)):
        try:
            family = socket.getaddrinfo(host, tried, type=socket.SOCK_STREAM)[0][0]
            with socket.socket(family, socket.SOCK_STREAM) as listening:
                if os.name == "posix":
                    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listening.bind((host, tried))
                listening.listen(1)
                return int(listening.getsockname()[1])
        except PermissionError:
            continue
        except UnicodeError as error:
            raise InputError(one_line(f"--host {host:.80}: is no name; expected an address of this machine")) from error
        except OSError as error:
            if isinstance(error, socket.gaierror) or error.errno not in _BUSY:
                said = f"--host {host:.80}: {error.strerror}; expected an address of this machine"
                raise InputError(one_line(said)) from error
    raise OutputError(f"--port {port}: it and the {TRIED - 1} after it are in use; expected a free one")


def _busy() -> set[int]:
    import errno

    return {errno.EADDRINUSE, getattr(errno, "WSAEADDRINUSE", errno.EADDRINUSE)}


_BUSY = _busy()
