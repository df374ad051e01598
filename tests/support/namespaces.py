"""A field on one machine: namespaces as computers, veth pairs as their radio, a bridge as access point.

    with Field() as field:
        robot2 = field.computer("robot2")            # 10.77.0.1, the next one is 10.77.0.2, …
        agent = robot2.start("formation", "agent", …)
        agent.event("ready")
        robot2.unplug()

The bridge stands in a namespace of its own, too, so nothing of this is seen from outside, addresses are the
same in every field, and fields side by side are told apart by the names of their namespaces. At the end of
the `with`, also after a failure, everything in the namespaces is killed and they are gone. A field whose
Python was killed is cleared away by the next one that is made.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, NamedTuple, Self

from tests.support.needs import path_of

NETWORK = "10.77.0"
ASIDE = "10.78.0"
"""The network on which a test looks on, in a field that has one: it is never unplugged."""
PATIENCE = 30.0
"""How long a test waits for what takes a fraction of a second on an idle machine [s]."""
PREFIX = "field"


class Link(NamedTuple):
    """An established TCP connection, as one computer sees it."""

    address: str
    port: int
    peer: str
    peer_port: int
    pid: int


class Running:
    """A process on a computer; what it says goes to files, so that no pipe can fill."""

    def __init__(self, process: subprocess.Popen[str], out: Path, err: Path) -> None:
        self.process = process
        self._out, self._err = out, err
        self._read = 0  # bytes of its output of which the events are known
        self._events: dict[str, list[dict[str, Any]]] = {}

    @property
    def pid(self) -> int:
        """The process itself, not a shell around it: to be killed, stopped and continued."""
        return self.process.pid

    @property
    def output(self) -> str:
        """What it wrote to stdout so far."""
        return self._out.read_text(errors="replace")

    @property
    def errors(self) -> str:
        """What it wrote to stderr so far."""
        return self._err.read_text(errors="replace")

    def events(self, name: str) -> list[dict[str, Any]]:
        """The events of this name that it said so far, as the project's processes say them."""
        with self._out.open("rb") as file:
            file.seek(self._read)
            new = file.read()
        whole = new[: new.rfind(b"\n") + 1]
        self._read += len(whole)
        for line in whole.decode(errors="replace").splitlines():
            if line.startswith("{"):
                event = json.loads(line)
                self._events.setdefault(event.get("event", ""), []).append(event)
        return list(self._events.get(name, ()))

    def tell(self, line: str, *, last: bool = False) -> None:
        """Write a line to its stdin, if it was started with one; close that after the last line."""
        assert self.process.stdin is not None
        print(line, file=self.process.stdin, flush=True)
        if last:
            self.process.stdin.close()

    def event(self, name: str, patience: float = PATIENCE) -> dict[str, Any]:
        """The last event of this name, waited for."""
        until(lambda: self.events(name) or self.ended, patience, f"event {name!r}")
        found = self.events(name)
        assert found, f"{self.process.args!r} ended without saying {name!r}: {self.errors}"
        return found[-1]

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def stop(self, patience: float = PATIENCE) -> int:
        """Ask it to end (SIGTERM) and wait; its exit code."""
        self.process.terminate()
        return self.process.wait(patience)

    def wait(self, patience: float = PATIENCE) -> int:
        """Its exit code, when it has ended by itself."""
        return self.process.wait(patience)


class Computer:
    """A network namespace with a loopback of its own and `eth0`, which ends at the field's access point."""

    def __init__(self, name: str, namespace: str, address: str, port: tuple[str, str], folder: Path) -> None:
        self.name, self.namespace, self.address = name, namespace, address
        self.prefix = (path_of("ip"), "netns", "exec", namespace)
        """What to write in front of a command line to have it run here; the process keeps its id."""
        self._switch, self._port = port
        self._folder = folder
        self._started: list[Running] = []

    def start(
        self,
        *argv: str | Path,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
        stdin: int = subprocess.DEVNULL,
    ) -> Running:
        stem = self._folder / f"{self.name}.{len(self._started)}"
        out, err = stem.with_suffix(f"{stem.suffix}.out"), stem.with_suffix(f"{stem.suffix}.err")
        with out.open("w") as output, err.open("w") as errors:
            process = subprocess.Popen(
                [*self.prefix, *map(str, argv)],
                stdin=stdin,
                stdout=output,
                stderr=errors,
                env=env,
                cwd=cwd,
                text=True,
                start_new_session=True,  # the terminal's Ctrl-C is for the tests, which end it themselves
            )
        self._started.append(Running(process, out, err))
        return self._started[-1]

    def run(
        self,
        *argv: str | Path,
        env: Mapping[str, str] | None = None,
        timeout: float = PATIENCE,
        text: str = "",
    ) -> subprocess.CompletedProcess[str]:
        """Run a command here to its end, `text` being its input; whether it failed is the caller's to see."""
        command = [*self.prefix, *map(str, argv)]
        return subprocess.run(
            command, input=text, env=env, timeout=timeout, capture_output=True, text=True, check=False
        )

    def unplug(self) -> None:
        """Out of the radio's reach: nothing comes, nothing goes, and no process is notified."""
        _ip("-n", self._switch, "link", "set", self._port, "down")

    def plug(self) -> None:
        """Within reach again."""
        _ip("-n", self._switch, "link", "set", self._port, "up")

    def roam(self, access_point: str = "bridge") -> None:
        """Within reach of another access point of the field, or of the first one again."""
        _ip("-n", self._switch, "link", "set", self._port, "master", access_point)

    @property
    def port(self) -> str:
        """What it is plugged in at, at the access point."""
        return self._port

    def nft(self, rules: str) -> None:
        """Apply a script of nft to this computer's firewall, such as one that loses packets."""
        done = self.run(path_of("nft"), "-f", "-", text=rules)
        assert done.returncode == 0, done.stderr

    def links(self, pid: int | None = None) -> set[Link]:
        """Established TCP connections of this computer, or of one process on it, to other computers."""
        done = self.run(path_of("ss"), "-tnpH", "state", "established")
        assert done.returncode == 0, done.stderr
        found = set()
        for line in done.stdout.splitlines():
            _, _, here, there, *users = line.split(None, 4)
            address, _, port = here.rpartition(":")
            peer, _, peer_port = there.rpartition(":")
            owner = re.search(r"pid=(\d+)", users[0] if users else "")
            link = Link(_bare(address), int(port), _bare(peer), int(peer_port), int(owner[1]) if owner else 0)
            if link.peer != link.address and pid in {None, link.pid}:
                found.add(link)
        return found

    def close(self) -> None:
        """Kill whatever runs here, take the namespace away."""
        for running in self._started:  # one that has hardly begun is not in the namespace yet
            running.process.kill()
            if running.process.stdin is not None:
                running.process.stdin.close()
            running.process.wait(PATIENCE)
        _clear(self.namespace)


class Field:
    """Computers that reach each other through one access point, and nothing else; a context manager."""

    def __init__(self, *, aside: bool = False) -> None:
        """With `aside` they have `eth1` as well, 10.78.0.1 and so on: for observers, and no robot."""
        self._aside = aside
        _clear_abandoned()
        self._stem = f"{PREFIX}-{os.getpid()}-{secrets.token_hex(3)}"
        self._switch = f"{self._stem}-switch"
        self._folder = tempfile.TemporaryDirectory(prefix=f"{self._stem}-")
        self._center = Computer("switch", self._switch, "", (self._switch, ""), Path(self._folder.name))
        self.computers: dict[str, Computer] = {}

    def __enter__(self) -> Self:
        try:
            _add(self._switch)
            for bridge in ("bridge", *["aside"] * self._aside):
                self.access_point(bridge)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def computer(self, name: str) -> Computer:
        """A new computer; its address is the next free one."""
        assert name not in self.computers, f"there is a computer {name!r} already"
        number = len(self.computers) + 1
        namespace, port = f"{self._stem}-{name}", f"port{number}"
        computer = Computer(
            name, namespace, f"{NETWORK}.{number}", (self._switch, port), Path(self._folder.name)
        )
        self.computers[name] = computer  # from here on it is cleared away
        _add(namespace)
        self._wire(namespace, "eth0", port, "bridge", computer.address)
        if self._aside:
            self._wire(namespace, "eth1", f"aside{number}", "aside", f"{ASIDE}.{number}")
        return computer

    def access_point(self, name: str) -> None:
        """One more, which reaches no other."""
        _ip("-n", self._switch, "link", "add", name, "type", "bridge")
        _ip("-n", self._switch, "link", "set", name, "up")

    def take_over(self, computers: Iterable[Computer]) -> tuple[Computer, list[str]]:
        """Where these are plugged in, for an access point in place of the bridge: ports.

        The first is a stand-in for the access point's own computer, to start that on.
        """
        ports = [computer.port for computer in computers]
        for port in ports:
            _ip("-n", self._switch, "link", "set", port, "nomaster")
        return self._center, ports

    def close(self) -> None:
        """Kill and remove all of it. May be called twice."""
        with ExitStack() as stack:  # each of them, though another one's end may fail
            stack.callback(self._folder.cleanup)
            stack.callback(self._center.close)
            for computer in self.computers.values():
                stack.callback(computer.close)

    def _wire(self, namespace: str, device: str, port: str, bridge: str, address: str) -> None:
        peer = ("type", "veth", "peer", "name", port, "netns", self._switch)
        _ip("link", "add", device, "netns", namespace, *peer)
        _ip("-n", self._switch, "link", "set", port, "master", bridge, "up")
        _ip("-n", namespace, "address", "add", f"{address}/24", "dev", device)
        _ip("-n", namespace, "link", "set", device, "up")


def until(true: Callable[[], object], patience: float = PATIENCE, what: str = "") -> None:
    """Wait for a condition, looking at it often; AssertionError when `patience` [s] is over."""
    deadline = time.monotonic() + patience
    while not true():
        assert time.monotonic() < deadline, f"not within {patience:g} s: {what or true}"
        time.sleep(0.02)


def _ip(*words: str) -> str:
    done = subprocess.run([path_of("ip"), *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"ip {' '.join(words)}: {done.stderr.strip()}"
    return done.stdout


def _add(namespace: str) -> None:
    _ip("netns", "add", namespace)
    _ip("-n", namespace, "link", "set", "lo", "up")


def _clear(namespace: str) -> None:
    """Kill what runs in a namespace and remove it, if it is there."""
    if namespace in set(_namespaces()):
        for pid in _ip("netns", "pids", namespace).split():
            with suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)
        _ip("netns", "delete", namespace)


def _clear_abandoned() -> None:
    for namespace in filter(_abandoned, _namespaces()):
        with suppress(AssertionError):  # another one that is being made may clear it at the same time
            _clear(namespace)
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}-*"):
        if _abandoned(folder.name):
            shutil.rmtree(folder, ignore_errors=True)


def _abandoned(name: str) -> bool:
    owner = re.fullmatch(rf"{PREFIX}-(\d+)-[0-9a-f]{{6}}-.+", name)
    return owner is not None and not Path(f"/proc/{owner[1]}").exists()


def _namespaces() -> Iterator[str]:
    return (line.split()[0] for line in _ip("netns", "list").splitlines() if line.strip())


def _bare(address: str) -> str:
    """An address without brackets, interface and the prefix of IPv4 written as IPv6."""
    return address.strip("[]").partition("%")[0].removeprefix("::ffff:")
