"""Shared by push, rollback and status: the robots of a folder of bundles, and requests to all at once."""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from formation.deploy.arguments import add_json, whole
from formation.deploy.fleet.on_robot import CONFIGURATION, VERSION
from formation.deploy.fleet.remote import RemoteError, Robot, Ssh
from formation.deploy.fleet.wheels import digest
from formation.deploy.refusal import Refusal, refuse_errors
from formation.mission.file import MissionError, load
from formation.transport.wiring import named

PREFIX = "/opt/formation"
BUNDLE = "BUNDLE.json"
"""File that lists the folders of all bundles."""
ADDRESS_PATTERN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.:%-]*")
PREFIX_PATTERN = re.compile(r"/[A-Za-z0-9_./{}-]+")
"""A prefix: absolute, and without special characters of a shell or systemd."""
EXPIRING_LIFE_SHARE = 0.2
"""Remaining share of its life at which a certificate counts as about to expire."""
RENEW = "formation deploy certificates MISSION --out DIR --renew, then bundle and push"
T = TypeVar("T")


class Bundle(NamedTuple):
    """One robot's folder, as `formation deploy bundle` made it."""

    robot: str
    folder: Path
    version: Mapping[str, Any]
    """Content of its VERSION.json."""
    mission_sha256: str

    @property
    def release(self) -> str:
        """Name of the release that it installs."""
        return str(self.version["release"])

    def differing(self, prefix: str, there: Mapping[str, str | None]) -> tuple[str, ...]:
        """Return the files of the configuration that differ from those installed under `prefix`.

        `there` has their digests on the robot; None if it may not be read there.
        """
        names = [name for name in CONFIGURATION if (self.folder / name).is_file()]
        return tuple(
            name for name in names if there.get(name, "") not in {None, self._installed(name, prefix)}
        )

    def _installed(self, name: str, prefix: str) -> str:
        """Return the digest that a file has when it is installed."""
        content = (self.folder / name).read_bytes()
        if name == "zenoh.json5":
            content = content.replace(b"@PREFIX@", prefix.removesuffix("/").encode())
        return hashlib.sha256(content).hexdigest()


def expiry(version: Mapping[str, Any], now: float) -> str:
    """Return when the certificate of a VERSION.json expires, and what to do; empty if that is not soon.

    `now` [s since the epoch].
    """
    since, until = version.get("certificate_since"), version.get("certificate_until")
    if since is None or until is None:  # made by an earlier version, or without certificates
        return ""
    ends = datetime.fromisoformat(until)
    left = ends.timestamp() - now
    if not 0.0 < left < EXPIRING_LIFE_SHARE * (ends - datetime.fromisoformat(since)).total_seconds():
        return ""
    return f"its certificate expires on {ends:%Y-%m-%d}, in {left / 86_400.0:.0f} days: {RENEW}"


class Fleet(NamedTuple):
    """The requested robots, their bundles, and how to reach them."""

    bundles: Mapping[str, Bundle]
    robots: Mapping[str, Robot]
    ssh: Ssh
    jobs: int


def add_no_restart(options: argparse.ArgumentParser) -> None:
    """Add --no-restart, for the commands that change what runs."""
    options.add_argument(
        "--no-restart",
        action="store_true",
        help="leave running processes as they are until they are restarted by hand",
    )


def add_flags(options: argparse.ArgumentParser) -> None:
    """Add DIR, and the flags that select robots and connections."""
    options.add_argument("folder", metavar="DIR", type=Path, help="what `formation deploy bundle` made")
    options.add_argument(
        "--user", metavar="NAME", help="log in as (default: as ssh's own configuration says)"
    )
    options.add_argument(
        "--host", metavar="ROBOT=ADDRESS", action="append", default=[],
        help="where to log in, instead of the address of its endpoint in the mission; repeatable",
    )  # fmt: skip
    options.add_argument(
        "--only", metavar="ROBOT", nargs="+", action="extend", default=[],
        help="these robots, not all; repeatable",
    )  # fmt: skip
    options.add_argument(
        "--prefix", metavar="PATH", default=PREFIX,
        help=f"where it is installed; {{robot}} stands for the robot's name (default {PREFIX})",
    )  # fmt: skip
    options.add_argument(
        "--ssh-option", metavar="OPTION", action="append", default=[],
        help="as ssh's -o, such as Port=2222; repeatable",
    )  # fmt: skip
    options.add_argument(
        "--jobs", metavar="N", type=whole(1, 256), default=16, help="robots at once (default 16)"
    )
    add_json(options)


def read(options: argparse.Namespace, *, sudo: bool = True) -> Fleet:
    """Return the fleet that the flags request. Raises Refusal."""
    bundles = bundles_in(options.folder)
    addresses: dict[str, str] = {}
    for robot, address in (_address(text, bundles) for text in options.host):
        if addresses.setdefault(robot, address) != address:
            raise Refusal(f"--host: {robot} has two addresses, {addresses[robot]} and {address}")
    unknown = [name for name in options.only if name not in bundles]
    if unknown:
        raise Refusal(f"--only {unknown[0]!r}: must be one of {', '.join(bundles)}")
    if not PREFIX_PATTERN.fullmatch(options.prefix) or options.prefix.replace("{robot}", "").count("{"):
        raise Refusal(f"--prefix {options.prefix!r}: must be an absolute path of letters, digits, . _ - /")
    mentioned = {*options.only, *addresses}
    chosen = {name: bundle for name, bundle in bundles.items() if not options.only or name in options.only}
    here = [name for name, one in chosen.items() if name not in mentioned and _leads_from_here(one)]
    for name in here:
        del chosen[name]
        print(
            f"{name}: leads from this machine, left out; --only {name} includes it",
            file=sys.stderr,
        )
    if not chosen:
        raise Refusal(f"{options.folder}: no robots selected; use --only NAME")
    robots = {
        name: Robot(
            name, addresses.get(name) or _from_mission(bundle), options.prefix.replace("{robot}", name)
        )
        for name, bundle in chosen.items()
    }
    places = [(robot.address, robot.prefix) for robot in robots.values()]
    for name, place in zip(robots, places, strict=True):
        if places.count(place) > 1:
            raise Refusal(f"{name}: another robot is to be installed at {place[0]}:{place[1]} as well")
    return Fleet(chosen, robots, Ssh(options.user, options.ssh_option, sudo=sudo), options.jobs)


def bundles_in(folder: Path) -> dict[str, Bundle]:
    """Return the installable bundles in a folder, by robot. Raises Refusal."""
    if not folder.is_dir():
        fault = "is a file" if folder.exists() else "no such folder"
        raise Refusal(f"{folder}: {fault}; DIR is the folder that `formation deploy bundle` made")
    bundles = {}
    missing = [name for name in _listed(folder) if not (folder / name).is_dir()]
    if missing:
        raise Refusal(
            f"{folder}: {', '.join(missing)} missing, of those that `formation deploy bundle` makes: it was"
            " interrupted, or a folder was removed; make the bundles again"
        )
    for path in sorted(folder.iterdir(), key=_natural_order):
        if (path / VERSION).is_file() and (path / "install.sh").is_file():
            bundles[path.name] = _bundle(path)
    if not bundles:
        raise Refusal(f"{folder}: holds no bundles (folders with {VERSION} and install.sh); "
                      "`formation deploy bundle` makes them")  # fmt: skip
    return bundles


def on_all(fleet: Fleet, query: Callable[[Robot], T]) -> dict[str, T | RemoteError]:
    """Return the result of `query` for each robot, run in parallel; a failure does not stop the others."""

    def one(robot: Robot) -> T | RemoteError:
        try:
            return query(robot)
        except RemoteError as error:
            return error
        except OSError as error:
            return RemoteError(f"{error.filename or 'the bundle'} cannot be sent: {error.strerror or error}")
        except (LookupError, TypeError, ValueError) as error:
            return RemoteError(f"its answer cannot be used: {error!r}; is {robot.address} this robot?")

    with ThreadPoolExecutor(max_workers=fleet.jobs, thread_name_prefix="robot") as pool:
        waiting: dict[str, Future[T | RemoteError]] = {}
        try:
            for name, robot in fleet.robots.items():
                waiting[name] = pool.submit(one, robot)
            return {name: future.result() for name, future in waiting.items()}
        except KeyboardInterrupt:
            fleet.ssh.stop()  # else the pool would wait for every robot
            done = [name for name, one in waiting.items() if not isinstance(one.result(), RemoteError)]
            rest = [name for name in fleet.robots if name not in done]
            print(
                f"\nformation: done on {', '.join(done) or 'no robot'}; not on {', '.join(rest) or 'none'},"
                " or not known: `formation deploy status` tells",
                file=sys.stderr,
            )
            raise


def _listed(folder: Path) -> Sequence[str]:
    """Return the folders that `formation deploy bundle` made, as it lists them; none if it does not."""
    try:
        listed = json.loads((folder / BUNDLE).read_text(encoding="utf-8"))["folders"]
    except (OSError, ValueError, KeyError, TypeError):
        return ()
    return [name for name in listed if isinstance(name, str)] if isinstance(listed, list) else ()


def _bundle(path: Path) -> Bundle:
    try:
        version = json.loads((path / VERSION).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise Refusal(f"{path / VERSION}: cannot be read: {error}") from None
    if not isinstance(version, dict) or not isinstance(version.get("release"), str):
        raise Refusal(f"{path / VERSION}: does not name a release")
    if version.get("robot", path.name) != path.name:
        raise Refusal(
            f"{path}: is the bundle of {version['robot']}, not of {path.name}; make the bundles again"
        )
    mission = path / "mission.toml"
    if not mission.is_file():
        raise Refusal(f"{path}: has no mission.toml; make the bundles again")
    return Bundle(path.name, path, version, digest(mission))


def _address(text: str, bundles: Mapping[str, Bundle]) -> tuple[str, str]:
    robot, _, address = text.partition("=")
    if robot not in bundles or not address:
        raise Refusal(f"--host {text!r}: must be ROBOT=ADDRESS with one of {', '.join(bundles)}")
    if not ADDRESS_PATTERN.fullmatch(address.strip("[]")):
        raise Refusal(f"--host {text!r}: {address!r} is no address; write it as 192.168.1.11")
    return robot, address.strip("[]")


def _from_mission(bundle: Bundle) -> str:
    """Return the host of the endpoint at which its agent listens."""
    with refuse_errors(MissionError):
        mission = load(bundle.folder / "mission.toml")
    endpoint = named(mission).get(bundle.robot)
    if endpoint is None:
        raise Refusal(
            f"{bundle.robot}: the mission names no endpoint for it; give its address with "
            f"--host {bundle.robot}=ADDRESS"
        )
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")


def _leads_from_here(bundle: Bundle) -> bool:
    """Return whether it is a candidate with an endpoint on this machine, most likely the desk."""
    if bundle.version.get("role") not in {"leader", "standby"}:
        return False
    try:
        place = socket.getaddrinfo(_from_mission(bundle), 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(place[0], socket.SOCK_STREAM) as probe:
            probe.bind(place[4])  # a machine can bind only its own addresses
    except (OSError, UnicodeError):  # a host name that cannot be one
        return False
    return True


def _natural_order(path: Path) -> tuple[str, int]:
    """Sort robot10 behind robot9."""
    match = re.fullmatch(r"(.*?)(\d+)", path.name)
    return (match[1], int(match[2])) if match else (path.name, -1)
