"""`formation deploy certificates`: a certificate authority, and a short-lived certificate for each process.

::

    DIR/ca/{key,certificate}.pem                 the authority; its key never leaves this folder
    DIR/NAME/{key,certificate,ca}.pem            each robot and standby, the leader, the monitor, the operator

Zenoh has no list of revoked certificates, so a stolen key works until its certificate expires. Renewing
issues new keys and certificates under the same authority, so it can be done robot by robot.
"""

from __future__ import annotations

import argparse
import os
import stat
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Any

from formation.deploy.arguments import (
    add_json,
    add_mission,
    add_out,
    number,
    parser,
    print_result,
    read_mission,
    replacing,
)
from formation.deploy.fleet import authority
from formation.deploy.fleet.access import AUTHORITY, hosts
from formation.deploy.fleet.authority import Pair
from formation.deploy.refusal import Refusal, refuse_os_errors
from formation.mission.model import Mission
from formation.mission.rules import VISITORS
from formation.transport.security.signing import issued_by
from formation.transport.wiring import members

KEY, CERTIFICATE, TRUSTED = "key.pem", "certificate.pem", "ca.pem"
DAYS, AUTHORITY_DAYS = 30.0, 365.0
MAX_COMMON_NAME_CHARS = 64
"""Longest common name [characters]."""
EXAMPLES = """\
  formation deploy certificates pair.toml --out secrets
  formation deploy certificates pair.toml --out secrets --renew --days 7

Anyone with secrets/robot2/key.pem can send as robot2, and anyone with secrets/ca/key.pem can issue any
certificate. Keep the folder on the desk; `formation deploy bundle` takes from it what a robot needs.
"""


def main(arguments: Sequence[str]) -> int:
    """Issue or renew certificates; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    now = datetime.now(UTC)
    if options.renew:
        pairs = renew(mission, options.out, days=options.days, now=now)
    else:
        pairs = create(mission, options.out, days=options.days, authority_days=options.ca_days, now=now)
    left = left_over(options.out, mission)
    print_result(options, words(options.out, pairs, left, now), lambda: report(options.out, pairs, left, now))
    return 0


def create(
    mission: Mission, folder: Path, *, days: float, authority_days: float, now: datetime
) -> dict[str, Pair]:
    """Make the authority and all certificates; return them by name, the authority's first.

    Raises Refusal if `folder` is not safe, or already holds keys.
    """
    hosts(mission)
    _prepare(folder)
    home = folder / AUTHORITY
    if _holds_keys(home):
        raise Refusal(f"{folder}: holds keys already; --renew issues new ones under the same authority")
    root = authority.new_authority(f"formation {mission.name}"[:MAX_COMMON_NAME_CHARS], authority_days, now)
    _write(home / KEY, root.key_pem)
    _write(home / CERTIFICATE, root.certificate_pem)
    return {AUTHORITY: root, **_issue_all(mission, folder, root, days, now)}


def renew(mission: Mission, folder: Path, *, days: float, now: datetime) -> dict[str, Pair]:
    """Issue new keys and certificates to all of the mission under the existing authority.

    Raises Refusal without one, or if it has expired.
    """
    hosts(mission)
    if not _holds_keys(folder / AUTHORITY):
        raise Refusal(f"{folder}: holds no authority to renew under; leave out --renew to make one")
    _prepare(folder)
    root = read_authority(folder)
    if root.expires <= now:
        raise Refusal(
            f"{folder / AUTHORITY}: the authority has expired on {root.expires:%Y-%m-%d}; make a new one in"
            " another folder and give all robots its certificates"
        )
    return {AUTHORITY: root, **_issue_all(mission, folder, root, days, now)}


def read_authority(folder: Path) -> Pair:
    """Return the authority of `folder`. Raises Refusal."""
    return authority.read(folder / AUTHORITY / CERTIFICATE, folder / AUTHORITY / KEY)


def read(folder: Path, name: str, now: datetime) -> Pair:
    """Return certificate and key of one process. Raises Refusal, with the cause, if not valid now."""
    home = folder / name
    if not home.is_dir():
        flag = " --renew" if _holds_keys(folder / AUTHORITY) else ""
        raise Refusal(
            f"{folder}: no certificate for {name};"
            f" `formation deploy certificates MISSION --out {quote(str(folder))}{flag}` issues one"
        )
    pair = authority.read(home / CERTIFICATE, home / KEY)
    if pair.name != name:
        raise Refusal(f"{home / CERTIFICATE}: is the certificate of {pair.name!r}, not of {name!r}")
    if not issued_by(pair.certificate, authority.read_certificate(home / TRUSTED)):
        raise Refusal(f"{home / CERTIFICATE}: was not issued by {home / TRUSTED}; renew it")
    if pair.expires <= now:
        raise Refusal(f"{home / CERTIFICATE}: has expired on {pair.expires:%Y-%m-%d %H:%M} UTC; renew it")
    begins = pair.certificate.not_valid_before_utc
    if begins > now:
        raise Refusal(
            f"{home / CERTIFICATE}: is valid only from {begins:%Y-%m-%d %H:%M} UTC on, and by this machine's"
            f" clock it is {now:%Y-%m-%d %H:%M}: set the clock, or renew it"
        )
    return pair


def left_over(folder: Path, mission: Mission) -> dict[str, datetime]:
    """Return names with a certificate there that are not in the mission, and when it expires."""
    known = {AUTHORITY, *members(mission), *VISITORS}
    found = sorted(path for path in folder.glob(f"*/{CERTIFICATE}") if path.parent.name not in known)
    return {path.parent.name: authority.read_certificate(path).not_valid_after_utc for path in found}


def report(
    folder: Path, pairs: Mapping[str, Pair], left: Mapping[str, datetime], now: datetime
) -> dict[str, Any]:
    """Return the certificates for a script."""
    return {
        "folder": str(folder),
        "certificates": {
            name: {
                "folder": str(folder / name),
                "expires": pair.expires.isoformat(),
                "days": round(_days(pair.expires, now), 3),
                "addresses": list(authority.addresses(pair.certificate)),
            }
            for name, pair in pairs.items()
        },
        "not_in_mission": {name: expires.isoformat() for name, expires in left.items()},
    }


def words(folder: Path, pairs: Mapping[str, Pair], left: Mapping[str, datetime], now: datetime) -> str:
    """Return the certificates for people."""
    lines = [f"{'certificate of':<16}{'expires (UTC)':<20}{'in days':>8}  where it listens"]
    for name, pair in pairs.items():
        places = ", ".join(authority.addresses(pair.certificate)) or "nowhere"
        what = "signs the others" if name == AUTHORITY else places
        lines.append(f"{name:<16}{pair.expires:%Y-%m-%d %H:%M}    {_days(pair.expires, now):>8.1f}  {what}")
    for name, expires in left.items():
        if expires > now:
            lines.append(f"{name}: not in this mission; its certificate is valid until {expires:%Y-%m-%d}")
    lines.append(f"in {folder}; with {AUTHORITY}/{KEY} anyone can act as any robot: keep it on the desk")
    return "\n".join(lines)


def _issue_all(mission: Mission, folder: Path, root: Pair, days: float, now: datetime) -> dict[str, Pair]:
    places: dict[str, str | None] = {name: host.address for name, host in hosts(mission).items()}
    places.update(dict.fromkeys(VISITORS))
    pairs = {}
    for name, address in places.items():
        pairs[name] = authority.issue(root, name, address, days, now)
        _write(folder / name / TRUSTED, root.certificate_pem)
        # The key first: interrupted between the two, `read` finds that they do not match.
        _write(folder / name / KEY, pairs[name].key_pem)
        _write(folder / name / CERTIFICATE, pairs[name].certificate_pem)
    return pairs


def _prepare(folder: Path) -> None:
    """Make `folder` a place for secrets, or refuse: it must be private, and ignored by git."""
    with refuse_os_errors(f"--out {folder}"):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        entries = list(folder.iterdir())
    if entries and not (folder / AUTHORITY).is_dir():
        raise Refusal(f"--out {folder}: is not empty and no folder of certificates; name a new one")
    _private(folder)
    for name in entries:
        if name.is_dir():
            _private(name)
    _write(folder / ".gitignore", b"*\n")


def _private(path: Path) -> None:
    """Refuse a path that others can read, or own."""
    state = path.stat()
    if stat.S_IMODE(state.st_mode) & 0o077:
        mode = stat.S_IMODE(state.st_mode)
        raise Refusal(
            f"{path}: other users of this machine can read it (mode {mode:03o}); chmod 700 {path}, or name a"
            " folder on a file system with permissions"
        )
    if state.st_uid != os.geteuid():
        raise Refusal(
            f"{path}: belongs to another user, which could read the keys; name a folder of your own"
        )


def _holds_keys(home: Path) -> bool:
    return (home / KEY).exists() or (home / CERTIFICATE).exists()


def _write(path: Path, content: bytes) -> None:
    """Write a private file, completely or not at all."""
    with refuse_os_errors(f"{path}"):
        path.parent.mkdir(mode=0o700, exist_ok=True)
        _private(path.parent)
        with replacing(path) as new:
            _private(new)  # before anything secret is in it
            new.write_bytes(content)


def _days(expires: datetime, now: datetime) -> float:
    return (expires - now).total_seconds() / 86400.0


def _options() -> argparse.ArgumentParser:
    options = parser(
        "deploy certificates",
        "Make a certificate authority and a short-lived certificate for each process, or renew them.",
        EXAMPLES,
    )
    add_mission(options, law=False)
    add_out(options, "folder for them, readable by you alone", metavar="DIR", required=True)
    options.add_argument(
        "--days",
        type=number(0.0, 3650.0, "days", open_below=True),
        default=DAYS,
        help=f"how long certificates are valid (default {DAYS:g}); none longer than the authority",
    )
    options.add_argument(
        "--ca-days",
        type=number(0.0, 36500.0, "days", open_below=True),
        default=AUTHORITY_DAYS,
        metavar="DAYS",
        help=f"how long a new authority is valid (default {AUTHORITY_DAYS:g})",
    )
    options.add_argument(
        "--renew", action="store_true", help="issue new certificates under the existing authority"
    )
    add_json(options)
    return options
