"""`formation deploy bundle`: make one folder per robot with all its files, for a robot without internet.

::

    DIR/robot2/mission.toml zenoh.json5 VERSION.json install.sh
               certificates/{ca,certificate,key}.pem      its own only
               units/*.service samples/*                  for systemd, the bridge, the firewall
               wheels/*.whl                               the same files in every folder (hard links)
    DIR/leader/                                           likewise for the leader and standbys, by name
    DIR/desk/  mission.toml {monitor,operator,leader}.json5 {monitor,operator,leader}/*.pem
               and likewise for each standby, so that each can lead from the desk
    DIR/BUNDLE.json                                       marks DIR as one of ours, with its content

A release's id is a hash of its folder's content, so the same inputs make the same release. Nothing in DIR
changes before all new bundles are ready, and a folder with other content is left alone.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Any

from formation.deploy import env
from formation.deploy.arguments import add_json, add_mission, add_out, as_json, parser, read_driven
from formation.deploy.fleet import access, authority, certificates, wheels
from formation.deploy.fleet import units as systemd
from formation.deploy.fleet.access import hosts
from formation.deploy.fleet.fleet import BUNDLE
from formation.deploy.fleet.on_robot import VERSION
from formation.deploy.fleet.wheels import PLATFORMS, PYTHONS, Target, digest
from formation.deploy.refusal import Refusal, refuse_os_errors
from formation.mission.file import DESK, read
from formation.mission.model import Mission
from formation.mission.rules import VISITORS
from formation.transport.wiring import members, role

LEADER = "leader"
"""The leader's name on the desk."""
SECRETS = (certificates.TRUSTED, certificates.CERTIFICATE, certificates.KEY)
LOOPBACK = ("tcp/127.0.0.1:", "tcp/[::1]:", "tcp/localhost:")
EXAMPLES = """\
  formation deploy bundle pair.toml --certificates secrets --out field
  formation deploy bundle pair.toml --certificates secrets --out field --python 3.11
  formation deploy push field

Or carry a robot's folder to it by hand, and there: sudo sh install.sh
"""


def main(arguments: Sequence[str]) -> int:
    """Make the bundles; return the exit code."""
    chosen = _options().parse_args(arguments)
    mission = read_driven(chosen.mission)
    text, _ = read(chosen.mission)
    refuse_unfit(mission)
    target = Target(chosen.platform, chosen.python)
    try:
        result = make(
            mission,
            text,
            chosen.out,
            chosen.certificates,
            target,
            now=datetime.now(UTC),
            with_wheels=not chosen.no_wheels,
            bringup=chosen.bringup,
            bridge=chosen.bridge,
        )
    except OSError as error:  # mostly a full disk
        raise Refusal(f"--out {chosen.out}: {error.strerror or error}; its content is unchanged") from None
    print(as_json(result) if chosen.json else words(chosen.out, result))
    return 0


def refuse_unfit(mission: Mission) -> None:
    """Raise Refusal for a mission that is not for robots in the field."""
    hosts(mission)
    if DESK in members(mission):
        raise Refusal(
            f"mission {mission.name}: no robot or standby can be called {DESK!r}, as that is the desk's"
            " folder; rename it"
        )
    if LEADER in mission.standbys:
        raise Refusal(
            f"mission {mission.name}: no standby can be called {LEADER!r}, as on the desk that is"
            f" {mission.leader}'s folder; rename it"
        )
    for name in mission.followers:
        endpoint = mission.robots[name].robot_endpoint
        if endpoint is None or not endpoint.startswith(LOOPBACK):
            raise Refusal(
                f"mission {mission.name}: robot_endpoint of {name} is {endpoint or 'missing'}; it must be"
                " where the robot's own ROS 2 bridge or router listens, on the robot itself and for nothing"
                " else: robot_endpoint = 'tcp/127.0.0.1:7447' in [robot]"
            )


def make(
    mission: Mission,
    text: str,
    out: Path,
    secrets: Path,
    target: Target,
    *,
    now: datetime,
    with_wheels: bool = True,
    bringup: str = systemd.BRINGUP,
    bridge: str | None = None,
) -> dict[str, Any]:
    """Fill `out` with a folder per robot and one for the desk; return the result. Raises Refusal.

    `text` is the mission's file. Earlier bundles there are replaced, folder by folder, once all the new ones
    are ready.
    """
    pairs = {name: _pair(secrets, mission, name, now) for name in access.processes(mission)}
    for name in members(mission):
        systemd.units(mission, name, bringup, bridge)  # refuse a wrong flag before fetching anything
    before = _earlier_folders(out)
    with _staging_folder(out) as staging:
        wheelhouse = staging / ".wheels"  # no robot has a name with a dot
        wheelhouse.mkdir()
        wheels.collect(target, wheelhouse, _earlier_wheels(out, before, target), fetch=with_wheels)
        facts = {
            "formation": version("zenoh-formation"),
            "commit": commit(),
            "mission": mission.name,
            "mission_sha256": hashlib.sha256(text.encode()).hexdigest(),
            "platform": target.platform,
            "python": target.python,
            "wheels": with_wheels,
        }
        releases = {}
        for name in members(mission):
            folder = staging / name
            _robot(folder, mission, name, text, secrets, (bringup, bridge))
            (folder / "wheels").mkdir(mode=0o755)
            for file in sorted(wheelhouse.iterdir()):
                wheels.link(file, folder / "wheels" / file.name)
            releases[name] = release_id(folder)
            own = {
                "release": releases[name],
                "robot": name,
                "role": role(mission, name),
                "bringup": "" if name in mission.candidates or bringup == systemd.NONE else bringup,
                **facts,
                "certificate_since": pairs[name].certificate.not_valid_before_utc.isoformat(),
                "certificate_until": pairs[name].expires.isoformat(timespec="seconds"),
                "units": sorted(path.name for path in (folder / "units").iterdir()),
                "made": _first_made(out / name, releases[name], now),
            }
            _write(folder / VERSION, json.dumps(own, indent=1) + "\n")
        _desk(staging / DESK, mission, text, secrets, out.resolve() / DESK)
        _replace(staging, out, (*members(mission), DESK), before)
    return {"folder": str(out), "releases": releases, **facts}


def commit() -> str:
    """Return the commit of this checkout, marked if files differ from it; empty if unknown."""
    if not (env.ROOT / ".git").exists():
        return ""
    describe = ["git", "-C", str(env.ROOT), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return env.run(describe).stdout.strip()
    except OSError:
        return ""


def words(out: Path, result: Mapping[str, Any]) -> str:
    """Return the result for people."""
    releases: Mapping[str, str] = result["releases"]
    lines = [f"{'robot':<16}release"]
    lines += [f"{name:<16}{release}" for name, release in releases.items()]
    bundles = quote(str(out))
    lines += [
        f"in {out}, for Python {result['python']} on {result['platform']}; next:",
        f"  formation deploy push {bundles}",
        f"  formation leader {bundles} --hold",
        f"  formation monitor {bundles}",
        f"  formation order {bundles} run",
        f"  formation stop {bundles}",
    ]
    return "\n".join(lines)


def _pair(secrets: Path, mission: Mission, name: str, now: datetime) -> authority.Pair:
    """Return a process's certificate, if it is valid now in this mission. Raises Refusal."""
    pair = certificates.read(secrets, name, now)
    where = hosts(mission).get(name)
    if where is not None and where.address not in authority.addresses(pair.certificate):
        found = ", ".join(authority.addresses(pair.certificate)) or "nowhere"
        raise Refusal(
            f"{secrets / name}: the certificate is for {name} at {found}, and in mission {mission.name} it"
            f" listens at {where.address}; renew it:"
            f" formation deploy certificates MISSION --out {quote(str(secrets))} --renew"
        )
    trusted = (secrets / name / certificates.TRUSTED).read_bytes()
    if trusted != (secrets / mission.leader / certificates.TRUSTED).read_bytes():
        raise Refusal(
            f"{secrets / name}: trusts another authority than {mission.leader} does; renew all of them"
        )
    return pair


def _robot(
    folder: Path, mission: Mission, name: str, text: str, secrets: Path, unit_flags: tuple[str, str | None]
) -> None:
    """Write a robot's folder, except wheels and VERSION.json."""
    folder.mkdir(mode=0o700)
    _write(folder / "mission.toml", text)
    place = PurePosixPath(systemd.CURRENT) / "certificates"
    _write(folder / "zenoh.json5", access.text(mission, name, access.configuration(mission, name, place)))
    _secrets(secrets / name, folder / "certificates")
    kinds = {"units": systemd.units, "samples": systemd.samples}
    for kind, texts in kinds.items():
        (folder / kind).mkdir(mode=0o755)
        for unit, content in texts(mission, name, *unit_flags).items():
            _write(folder / kind / unit, content)
    wall = files("formation.deploy").joinpath("fleet", "firewall.nft").read_text(encoding="utf-8")
    port = f"dport {hosts(mission)[name].port} "
    _write(folder / "samples" / "firewall.nft", wall.replace("dport 7460 ", port))
    script = files("formation.deploy").joinpath("fleet", "install.sh").read_text(encoding="utf-8")
    _write(folder / "install.sh", script, 0o755)


def _desk(folder: Path, mission: Mission, text: str, secrets: Path, place: Path) -> None:
    """Write the desk's folder for monitor, operator and candidates; it stays where it is made, `place`."""
    folder.mkdir(mode=0o700)
    _write(folder / "mission.toml", text)
    parts = {LEADER: mission.leader, **{name: name for name in (*VISITORS, *mission.standbys)}}
    for part, name in parts.items():
        settings = access.configuration(mission, name, place / part)
        _write(folder / f"{part}.json5", access.text(mission, name, settings))
        _secrets(secrets / name, folder / part)


def _secrets(source: Path, folder: Path) -> None:
    folder.mkdir(mode=0o700)
    for name in SECRETS:
        _write(folder / name, (source / name).read_text(encoding="ascii"), 0o600)


def _earlier_folders(out: Path) -> tuple[str, ...]:
    """Return the folders of an earlier run in `out`. Raises Refusal if it has other content."""
    with refuse_os_errors(f"--out {out}"):
        try:
            found = {path.name for path in out.iterdir()}
        except FileNotFoundError:
            return ()
    known: tuple[str, ...] = ()
    if BUNDLE in found:
        try:
            known = tuple(json.loads((out / BUNDLE).read_text(encoding="utf-8"))["folders"])
        except (OSError, ValueError, KeyError, TypeError):
            raise Refusal(f"{out / BUNDLE}: cannot be read; remove {out}, or name another folder") from None
    foreign = sorted(found - {BUNDLE, ".gitignore", *known})
    if foreign:
        shown = f"{', '.join(foreign[:3])}{' and more' if len(foreign) > 3 else ''}"
        raise Refusal(f"--out {out}: holds {shown}, which is in no bundle; name a new folder")
    return tuple(name for name in known if name in found)


@contextmanager
def _staging_folder(out: Path) -> Iterator[Path]:
    """Yield a folder beside `out`, on its file system, in which new bundles are made."""
    fresh = not out.exists()
    with refuse_os_errors(f"--out {out}"):
        out.mkdir(mode=0o700, parents=True, exist_ok=True)
        staging = tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.resolve().parent)  # mode 0700
    try:
        with staging as folder:
            yield Path(folder)
    except BaseException:
        if fresh and not any(out.iterdir()):
            out.rmdir()
        raise


def _replace(staging: Path, out: Path, folders: Sequence[str], before: Sequence[str]) -> None:
    """Move `folders` from `staging` to `out`, replacing those of `before`."""
    out.chmod(0o700)
    _write(out / ".gitignore", "*\n")
    # Until all is done the content may be of either run, so both are named.
    _write(out / BUNDLE, json.dumps({"folders": sorted({*folders, *before})}) + "\n")
    old = staging / ".old"
    old.mkdir()
    for name in before:
        (out / name).rename(old / name)
    for name in folders:
        (staging / name).rename(out / name)
    _write(out / BUNDLE, json.dumps({"folders": list(folders)}) + "\n")
    shutil.rmtree(old)


def release_id(folder: Path) -> str:
    """Return a hash of a folder's names, modes and contents, except VERSION.json."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != VERSION:
            total.update(f"{name} {path.stat().st_mode & 0o777:o} {digest(path)}\n".encode())
    return total.hexdigest()[:12]


def _earlier_wheels(out: Path, before: Sequence[str], target: Target) -> list[Path]:
    """Return the wheels that an earlier run fetched for the same target."""
    same = []
    for name in before:
        version = _version(out / name)
        if (version.get("platform"), version.get("python")) == target:
            same += sorted((out / name / "wheels").glob("*.whl"))
    return same


def _first_made(old: Path, release: str, now: datetime) -> str:
    """Return when a release was first made; a second run with the same result keeps the time."""
    version = _version(old)
    return str(version["made"]) if version.get("release") == release else now.isoformat(timespec="seconds")


def _version(folder: Path) -> Mapping[str, Any]:
    try:
        version = json.loads((folder / VERSION).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return version if isinstance(version, dict) else {}


def _write(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file that is never more readable than `mode`."""
    path.unlink(missing_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        os.fchmod(handle, mode)  # whatever the umask
        file.write(text)


def _options() -> argparse.ArgumentParser:
    options = parser(
        "deploy bundle", "Make a folder per robot with all that it needs, without internet.", EXAMPLES
    )
    add_mission(options, law=False)
    add_out(options, "folder for the bundles", metavar="DIR", required=True)
    options.add_argument(
        "--certificates", required=True, type=Path, metavar="DIR",
        help="what `formation deploy certificates` made",
    )  # fmt: skip
    options.add_argument(
        "--platform",
        choices=PLATFORMS,
        default=PLATFORMS[0],
        help="the robots' platform (default %(default)s)",
    )
    options.add_argument(
        "--python",
        choices=PYTHONS,
        default="3.12",
        help="the robots' Python (default %(default)s, Ubuntu 24.04's)",
    )
    options.add_argument(
        "--no-wheels", action="store_true", help="robots fetch packages themselves, so they need internet"
    )
    options.add_argument(
        "--bringup", metavar="UNIT", default=systemd.BRINGUP,
        help=f"the robots' unit for their bring-up, or {systemd.NONE} (default %(default)s)",
    )  # fmt: skip
    options.add_argument(
        "--bridge", metavar="UNIT",
        help=f"the unit of their ROS 2 bridge or router, or {systemd.NONE} (default: by the mission's ros,"
        f" {' or '.join(systemd.BRIDGES.values())})",
    )  # fmt: skip
    add_json(options)
    return options
