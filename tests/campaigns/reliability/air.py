"""Air that takes its time: an access point in Python, for a kernel without `netem`.

``python -m tests.campaigns.reliability.air DELAY PORT...`` runs in the namespace of a field's access point,
in place of the bridge: what comes in by one port goes out by that of its receiver DELAY [s] later, in its
order. It says ``ready``.

The ports have to be out of the bridge, and computers' own offloads off (`unassisted`): frames have to be
whole, with sums, as they would be on a cable.
"""

from __future__ import annotations

import ctypes
import fcntl
import selectors
import socket
import struct
import sys
import time
from collections import deque

EVERY_FRAME = 0x0003  # ETH_P_ALL
SIOCETHTOOL, SET_TX_SUMS, SET_SEGMENTS = 0x8946, 0x17, 0x1F  # of linux/sockios.h and linux/ethtool.h


class Air:
    """Ports, the process behind each, and frames on their way."""

    def __init__(self, ports: list[socket.socket], delay: float) -> None:
        self.delay = delay
        self._ports = ports
        self._behind: dict[bytes, socket.socket] = {}
        self._way: deque[tuple[float, socket.socket, bytes]] = deque()

    @property
    def wait(self) -> float | None:
        """Until the next frame is due [s]; None if there is none."""
        return max(0.0, self._way[0][0] - time.monotonic()) if self._way else None

    def read_port(self, port: socket.socket) -> None:
        """Take what has come in by a port."""
        while True:
            try:
                frame, about = port.recvfrom(65535)
            except BlockingIOError:
                return
            if about[2] != socket.PACKET_OUTGOING:  # type: ignore[attr-defined,unused-ignore]
                self._behind[frame[6:12]] = port
                self._way.append((time.monotonic() + self.delay, port, frame))

    def give(self) -> None:
        """Deliver what is due to its receiver; to all others, if that is unknown."""
        now = time.monotonic()
        while self._way and self._way[0][0] <= now:
            _, origin, frame = self._way.popleft()
            known = self._behind.get(frame[:6])
            for port in [known] if known else [port for port in self._ports if port is not origin]:
                try:
                    port.send(frame)
                except OSError:
                    continue  # that computer is unplugged


def unassisted(device: str) -> None:
    """Have the kernel sum and cut what leaves by `device` itself, in this namespace."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for command in (SET_SEGMENTS, SET_TX_SUMS):
            requested = ctypes.create_string_buffer(struct.pack("II", command, 0))
            name = device.encode()
            fcntl.ioctl(any_socket, SIOCETHTOOL, struct.pack("16sP8x", name, ctypes.addressof(requested)))


def main(delay: str, *names: str) -> None:
    """Hand frames on until killed."""
    ports = []
    for name in names:
        port = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(EVERY_FRAME))
        port.bind((name, 0))
        port.setblocking(False)
        ports.append(port)
    air = Air(ports, float(delay))
    with selectors.DefaultSelector() as selector:
        for port in ports:
            selector.register(port, selectors.EVENT_READ, port)
        print('{"event": "ready", "process": "air"}', flush=True)
        while True:
            for key, _ in selector.select(air.wait):
                air.read_port(key.data)
            air.give()


if __name__ == "__main__":
    if sys.argv[1] == "unassisted":
        unassisted(sys.argv[2])
    else:
        main(*sys.argv[1:])
