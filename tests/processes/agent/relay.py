"""A cable between two processes of this machine that can be cut: bytes stop, and nobody is told."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from types import TracebackType
from typing import Self


class Relay:
    """Accepts TCP links and hands their bytes on, both ways, as long as it is not cut; a context manager."""

    def __init__(self, target: str, at: str = "tcp/127.0.0.1:0") -> None:
        """`target` is an endpoint such as ``tcp/127.0.0.1:7460``; links are taken `at` one, or at any."""
        self._target = _address(target)
        self._whole = threading.Event()
        self._whole.set()
        self._open = True
        self._sockets: list[socket.socket] = []
        self._door = socket.create_server(_address(at))
        self.endpoint = f"tcp/127.0.0.1:{self._door.getsockname()[1]}"
        """What to dial in place of the target."""
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False
        self._whole.set()
        for one in (self._door, *self._sockets):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def cut(self) -> None:
        """Nothing comes, nothing goes."""
        self._whole.clear()

    def mend(self) -> None:
        """What waited in the cable goes on its way."""
        self._whole.set()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._door.accept()
                self._whole.wait()
                far = socket.create_connection(self._target)
                self._sockets += [near, far]
                for source, sink in ((near, far), (far, near)):
                    source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    threading.Thread(target=self._hand_on, args=(source, sink), daemon=True).start()

    def _hand_on(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while self._open and (data := source.recv(65536)):
                self._whole.wait()
                sink.sendall(data)
        with suppress(OSError):
            sink.shutdown(socket.SHUT_WR)


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    return host, int(port)
