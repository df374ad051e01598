"""Attacks on a team: ``python -m tests.field.attacker`` runs those that stdin names, one JSON line for each.

Each ends with an event ``done``, which has the result as the attacker sees it.
"""

from __future__ import annotations

import json
import secrets
import signal
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zenoh

from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.protocol.request import OperatorRequest
from formation.ros2.messages import Pose, encode
from formation.transport.runtime.process import say
from tests.field.sessions import attacking
from tests.field.team import mission
from tests.support.namespaces import until

FAR = 5.0 + 5.0j
"""Forged position, far from the robot [m; world frame]."""
NEAR = -0.4 + 0.3j
"""Plausible position for the robot that the attacker pretends to be [m; world frame]."""


def forged(seconds: float, rate: float) -> Iterator[tuple[bytes, bytes]]:
    """Positions far away, each with an order to stop by a leader with a new term."""
    tag = mission().tag
    publisher_id, term, start = secrets.token_hex(8), time.time_ns(), time.monotonic()
    for count in range(int(seconds * rate)):
        what = Order(term=term, beat=count, mode="stop", shape="row")
        decoded = PositionAttachment(publisher_id=publisher_id, count=count, order=what, mission=tag)
        yield encode(Pose(time.time(), FAR, 1j)), json_message.encode(decoded)
        time.sleep(max(0.0, start + (count + 1) / rate - time.monotonic()))


def put(session: zenoh.Session, keys: list[str], seconds: float, rate: float = 40.0) -> int:
    """Put forged positions on all of `keys`; return their number."""
    sent = 0
    for payload, attachment in forged(seconds, rate):
        for key in keys:
            session.put(key, payload, attachment=attachment)
            sent += 1
    return sent


def query(session: zenoh.Session, keys: list[str]) -> int:
    """Request a stop as an operator does; return the number of replies."""
    payload = json_message.encode(OperatorRequest(do="stop"))
    how: dict[str, Any] = {"payload": payload, "timeout": 1.0, "target": zenoh.QueryTarget.ALL}
    replies = [session.get(key, **how) for key in keys]
    return sum(reply.ok is not None for received in replies for reply in received)


def declare(session: zenoh.Session, keys: list[str], seconds: float) -> int:
    """Declare liveliness tokens; return their number."""
    tokens = [session.liveliness().declare_token(key) for key in keys]
    time.sleep(seconds)
    return len(tokens)


def listen(session: zenoh.Session, key: str, number: int) -> list[tuple[str, str]]:
    """Receive `number` messages or a few more; return payloads and attachments in hexadecimal."""
    received: list[tuple[str, str]] = []

    def receive(sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        received.append((sample.payload.to_bytes().hex(), attachment.to_bytes().hex() if attachment else ""))

    subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(receive, indirect=False))
    until(lambda: len(received) >= number, what=f"{number} messages on {key}")
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    return received


def relay(session: zenoh.Session, key: str, attachments: list[str], rate: float = 40.0) -> int:
    """Publish these attachments with positions that are stamped now; return their number."""
    for attachment in attachments:
        pose = Pose(time.time(), NEAR, 1.0 + 0j)
        session.put(key, encode(pose), attachment=bytes.fromhex(attachment))
        time.sleep(1.0 / rate)
    return len(attachments)


def replay(session: zenoh.Session, key: str, samples: list[tuple[str, str]], rate: float = 40.0) -> int:
    """Publish recorded messages again; return their number."""
    for payload, attachment in samples:
        session.put(key, bytes.fromhex(payload), attachment=bytes.fromhex(attachment))
        time.sleep(1.0 / rate)
    return len(samples)


def dial(how: dict[str, Any], times: int) -> int:
    """Try to link `times` times; return the number of links."""
    worked = 0
    for _ in range(times):
        try:
            with attacking(**how):
                worked += 1
        except zenoh.ZError:
            time.sleep(0.1)
    return worked


def crowd(address: str, port: int, number: int, seconds: float) -> int:
    """Open connections and send a few bytes on each, too few for a handshake; return their number."""
    taken = [socket.create_connection((address, port), timeout=5.0) for _ in range(number)]
    for byte in b"\x16\x03\x01\x02":
        time.sleep(seconds / 4)
        for one in taken:
            try:
                one.send(bytes([byte]))
            except OSError:
                one.close()
    return len(taken)


def knock(address: str, port: int) -> int:
    """Begin links without a certificate as fast as possible until SIGTERM; return their number."""
    over: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: over.append(number))
    knocked = 0
    while not over:
        try:
            with socket.create_connection((address, port), timeout=0.2) as one:
                one.sendall(b"\x16\x03\x01\x00\x05nonsense")
                if knocked == 0:
                    say("knocking")
                knocked += 1
        except OSError:
            time.sleep(0.01)
    return knocked


def talk(address: str, port: int, words: bytes) -> int:
    """Send bytes that are no TLS; return the number of bytes received."""
    with socket.create_connection((address, port), timeout=5.0) as link:
        link.sendall(words)
        try:
            return len(link.recv(4096))
        except ConnectionResetError:
            return 0


def main(kind: str, how: dict[str, Any]) -> None:
    result: object
    match kind:
        case "dial":
            result = dial(_paths(how["link"]), how["times"])
        case "crowd":
            result = crowd(**how)
        case "knock":
            result = knock(**how)
        case "talk":
            result = talk(how["address"], how["port"], bytes.fromhex(how["words"]))
        case _:
            attacks = (put, query, declare, listen, relay, replay)
            does = {one.__name__: one for one in attacks}[kind]
            with attacking(**_paths(how.pop("link"))) as session:
                time.sleep(0.3)  # until both sides have exchanged declarations
                result = does(session, **how)
                time.sleep(0.3)  # messages are sent before the link closes
    say("done", result=result)


def _paths(link: dict[str, Any]) -> dict[str, Any]:
    return {**link, "identity": Path(link["identity"]), "trusted": Path(link["trusted"])}


if __name__ == "__main__":
    for line in sys.stdin:
        main(**json.loads(line))
