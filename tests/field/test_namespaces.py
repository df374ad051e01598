"""The field of namespaces that the tests in this folder stand on."""

from __future__ import annotations

import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.namespaces import Computer, Field, until
from tests.support.needs import path_of

pytestmark = pytest.mark.namespaces

EVERYWHERE = "0.0.0.0"  # noqa: S104 - in a namespace
LISTEN = """
import json, socket, sys
server = socket.create_server((sys.argv[1], 7447))
print(json.dumps({"event": "ready"}), flush=True)
kept = []
while True:
    kept.append(server.accept()[0])
    print(json.dumps({"event": "accepted"}), flush=True)
"""
DIAL = """
import json, socket, sys, time
kept = socket.create_connection((sys.argv[1], 7447), timeout=float(sys.argv[2]))
print(json.dumps({"event": "connected"}), flush=True)
time.sleep(60)
"""


def reaches(computer: Computer, other: Computer, patience: float = 0.5) -> bool:
    dialled = f"import socket; socket.create_connection(('{other.address}', 7447), {patience}).close()"
    return computer.run(sys.executable, "-c", dialled).returncode == 0


def namespaces() -> str:
    return subprocess.run([path_of("ip"), "netns", "list"], capture_output=True, text=True, check=True).stdout


def test_computers_reach_each_other_unless_unplugged_or_a_rule_forbids_it() -> None:
    with Field() as field:
        one, two = field.computer("one"), field.computer("two")
        two.start(sys.executable, "-c", LISTEN, two.address).event("ready")
        assert reaches(one, two, 5.0)
        two.unplug()
        assert not reaches(one, two)
        two.plug()
        until(lambda: reaches(one, two, 5.0))
        one.nft("add table inet f; add chain inet f out { type filter hook output priority 0; }")
        one.nft(f"add rule inet f out ip daddr {two.address} drop")
        assert not reaches(one, two)


def test_the_links_of_a_process_are_seen_without_those_to_itself() -> None:
    with Field() as field:
        one, two = field.computer("one"), field.computer("two")
        server = two.start(sys.executable, "-c", LISTEN, EVERYWHERE)
        server.event("ready")
        outside, inside = (
            where.start(sys.executable, "-c", DIAL, address, "5")
            for where, address in ((one, two.address), (two, "127.0.0.1"))
        )
        outside.event("connected")
        inside.event("connected")
        until(lambda: len(server.events("accepted")) == 2)
        (link,) = two.links(server.pid)
        assert (link.peer, link.port, link.pid) == (one.address, 7447, server.pid)
        assert {link.peer for link in one.links()} == {two.address}


def test_two_fields_have_the_same_addresses_and_do_not_meet() -> None:
    with Field() as field, Field() as other:
        here, there = (each.computer("robot1") for each in (field, other))
        (asking,) = (field.computer("robot2"),)
        assert here.address == there.address
        there.start(sys.executable, "-c", LISTEN, EVERYWHERE).event("ready")
        assert not reaches(asking, here)


def test_after_a_failure_nothing_is_left() -> None:
    with suppress(ZeroDivisionError), Field() as field:
        computer = field.computer("robot1")
        running = computer.start(sys.executable, "-c", "import time; time.sleep(600)")
        running.signal(signal.SIGSTOP)
        raise ZeroDivisionError
    assert running.ended
    assert computer.namespace not in namespaces()


def test_next_field_removes_leftovers_of_killed_python() -> None:
    program = """
import os, sys
from tests.support.namespaces import Field
field = Field()
computer = field.__enter__().computer("robot1")
child = computer.start(sys.executable, "-c", "import time; time.sleep(600)")
print(computer.namespace, child.pid, flush=True)
os.kill(os.getpid(), 9)
"""
    killed = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    namespace, pid = killed.stdout.split()
    assert namespace in namespaces()
    with Field():
        assert namespace not in namespaces()
        until(lambda: not Path(f"/proc/{pid}").exists())
