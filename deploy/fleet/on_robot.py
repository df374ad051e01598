"""The program that a push runs on a robot: sent as text, so the robot needs only Python 3.

``python3 -c TEXT COMMAND ARGUMENTS`` with the arguments as JSON. It answers with one line of JSON after
`MARK` on stdout (a login shell may print other text there), and before it the lines of an installation. This
file imports only the standard library, and nothing that only a new version has.

The bundle arrives in PREFIX/incoming, a mirror that remains after the push: its files are not sent again.
Releases are made from it by the bundle's own install.sh, which switches PREFIX/current last; until then the
running release is untouched.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import re
import select
import shutil
import signal
import stat
import subprocess
import sys
import tarfile
import time
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

MARK = "formation-answer: "
INCOMING, CURRENT, PREVIOUS, VERSION = "incoming", "current", "previous", "VERSION.json"
PUSHING, INSTALLING = ".lock", ".install.lock"  # files whose locks a push and an install.sh hold
UNFINISHED = ".unfinished"  # the file that exists until the current release's units have been started
INSTALLED = ".installed"  # the file that names the completely installed release
CONFIGURATION = (
    "mission.toml",
    "zenoh.json5",
    "certificates/ca.pem",
    "certificates/certificate.pem",
    "certificates/key.pem",
)
"""Files of a release that are this robot's own; install.sh restores them."""
AGENT = "formation-agent.service"
UNITS = (AGENT, "formation-watchdog.service", "formation-leader.service", "formation-standby.service")
SYSTEMD = Path("/etc/systemd/system")
Answer = dict[str, Any]


class Refused(Exception):  # noqa: N818 - the request fails; the text gives the cause
    """A request cannot be done on this robot; the text is one sentence."""


def look(prefix: Path, request: Answer) -> Answer:
    """Return the mirror's content, the current and the complete release, and the free space [bytes]."""
    _refuse_other_robot(prefix, request)
    incoming = prefix / INCOMING
    files = {}
    if incoming.is_dir():
        files = {_name(incoming, path): _facts(path) for path in _files(incoming)}
    done, disk = prefix / INSTALLED, prefix
    while not disk.exists():
        disk = disk.parent
    return {
        "files": files,
        "release": _release(prefix / CURRENT),
        "made": _json(prefix / CURRENT / VERSION).get("made"),
        "installed": done.read_text(encoding="utf-8", errors="replace") if done.is_file() else None,
        "configuration": _configuration(prefix / CURRENT),
        "free": shutil.disk_usage(str(disk)).free,
    }


def receive(prefix: Path, request: Answer) -> Answer:
    """Bring the mirror up to date from a tar stream on stdin, then install from it.

    Nothing is installed unless every file has the sender's digest.
    """
    incoming, wanted = prefix / INCOMING, request["files"]
    incoming.mkdir(parents=True, exist_ok=True)
    incoming.chmod(0o700)
    with _locked(prefix, PUSHING):
        with _locked(prefix, INSTALLING):  # one that a killed push left may still read the mirror
            _refuse_other_robot(prefix, request)
            _purge(incoming, wanted)
            _receive_files(incoming, wanted, sys.stdin.buffer)
            for name, facts in wanted.items():
                path = incoming / name
                if not path.is_file() or _facts(path)[0] != facts[0]:
                    raise Refused(f"{name} did not arrive as it was sent")
                path.chmod(facts[1])
        (prefix / INSTALLED).unlink(missing_ok=True)
        code = _install(incoming, request["install"])
        if code == 0:
            (prefix / INSTALLED).write_text(_release(prefix / CURRENT) or "", encoding="utf-8")
    return {
        "exit": code,
        "release": _release(prefix / CURRENT),
        "configuration": _configuration(prefix / CURRENT),
    }


def rollback(prefix: Path, request: Answer) -> Answer:
    """Link back to the release before the current one, and restart its units."""
    with _locked(prefix, PUSHING), _locked(prefix, INSTALLING):
        left, back = _release(prefix / CURRENT), _release(prefix / PREVIOUS)
        if left is None:
            raise Refused(f"nothing is installed under {prefix}")
        if back is None or back == left or not (prefix / PREVIOUS / VERSION).is_file():
            raise Refused(f"there is no release before {left}")
        _refuse_unfit(prefix / PREVIOUS, request)
        target = (prefix / PREVIOUS).readlink()
        new = prefix / f".{CURRENT}.{os.getpid()}"
        new.symlink_to(target, target_is_directory=True)
        if request["restart"]:
            (prefix / UNFINISHED).touch()
        new.replace(prefix / CURRENT)
        (prefix / PREVIOUS).unlink()
        output = _restart(prefix) if request["restart"] else ""
        if not output and (prefix / UNFINISHED).exists():
            (prefix / UNFINISHED).unlink()
    return {"left": left, "release": back, "restart": output}


def status(prefix: Path, _request: Answer) -> Answer:
    """Return the current release, since when, its VERSION.json, and its units' states."""
    current = prefix / CURRENT
    if _release(current) is None:
        return {"release": None}
    mission = current / "mission.toml"
    return {
        "release": _release(current),
        "previous": _release(prefix / PREVIOUS),
        "since": current.lstat().st_mtime,
        "now": time.time(),
        "version": _json(current / VERSION),
        "mission_sha256": _digest(mission) if mission.is_file() else None,
        "configuration": _configuration(current),
        "units": {unit: _unit(unit, prefix) for unit in _units(prefix)},
    }


def _refuse_other_robot(prefix: Path, request: Answer) -> None:
    """Refuse a machine that is another robot, unless the request renames it."""
    there = _json(prefix / CURRENT / VERSION).get("robot")
    if there and there != request["robot"] and not request["rename"]:
        raise Refused(
            f"this machine is {there}, not {request['robot']}: correct its address (endpoint, --host),"
            f" or make it {request['robot']} with --rename"
        )


def _refuse_unfit(home: Path, request: Answer) -> None:
    """Refuse to go back to a release of another robot, or with an expired certificate."""
    version = _json(home / VERSION)
    there, until = version.get("robot"), version.get("certificate_until")
    if there and there != request["robot"]:
        raise Refused(f"the release before is {there}'s, not {request['robot']}'s: push its bundle instead")
    if until and datetime.fromisoformat(until).timestamp() <= request["now"]:
        raise Refused(f"the certificate of the release before has expired on {until}: push a new bundle")


def _configuration(home: Path) -> Answer:
    """Return the digest of each file of its configuration that a release has; None if it cannot be read."""
    found: Answer = {}
    for name in CONFIGURATION:
        try:
            found[name] = _digest(home / name)
        except FileNotFoundError:
            continue
        except OSError:
            found[name] = None
    return found


def _purge(incoming: Path, wanted: Answer) -> None:
    """Remove what is not in the list, and what is no file: links, pipes."""
    for root, folders, names in os.walk(str(incoming)):
        for path in (Path(root) / name for name in (*folders, *names)):
            stays = path.name in folders or (path.is_file() and _name(incoming, path) in wanted)
            if path.is_symlink() or not stays:
                path.unlink()


def _receive_files(incoming: Path, wanted: Answer, stream: IO[bytes]) -> None:
    """Write each file of the stream under another name first, so that no name ever holds a partial file."""
    with tarfile.open(fileobj=stream, mode="r|") as archive:
        for entry in archive:
            if entry.name not in wanted or not entry.isfile():
                raise Refused(f"{entry.name!r} was sent, but it is not in the list")
            source = archive.extractfile(entry)
            assert source is not None  # noqa: S101 - for the type checker: it is a file
            path = incoming / entry.name
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f".{path.name}.part")
            part.unlink(missing_ok=True)
            # its mode from the first byte on: a key is never readable by others, not even while it arrives
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
            with os.fdopen(os.open(str(part), flags, wanted[entry.name][1] & 0o700), "wb") as file:
                shutil.copyfileobj(source, file, 1 << 16)
            if path.is_dir():
                shutil.rmtree(path)
            part.replace(path)


def _install(incoming: Path, arguments: Sequence[str]) -> int:
    """Run the bundle's install.sh, passing on its output; end it if the reader is gone."""
    child = subprocess.Popen(
        ["/bin/sh", "./install.sh", *arguments],
        cwd=str(incoming),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    assert child.stdout is not None  # noqa: S101 - for the type checker: it was asked for above
    if not _pass_on(child.stdout.fileno()):
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGTERM)
    return child.wait()


def _pass_on(source: int) -> bool:
    """Copy `source` to stdout until it ends; return False as soon as stdout has no reader."""
    waiting = select.poll()
    waiting.register(source, select.POLLIN)
    waiting.register(1, 0)  # only a broken pipe
    while True:
        for number, event in waiting.poll():
            if number == 1 and event & (select.POLLERR | select.POLLHUP):
                return False
            if number == source:
                block = os.read(source, 1 << 16)
                if not block:
                    return True
                try:
                    os.write(1, block)
                except BrokenPipeError:
                    return False


def _units(prefix: Path) -> list[str]:
    """Return the names of the units of the current release."""
    folder = prefix / CURRENT / "units"
    return sorted(path.name for path in folder.glob("*.service")) if folder.is_dir() else []


def _unit(name: str, prefix: Path) -> Answer:
    facts = unit_facts(name, "ActiveState,SubState,StatusText,NRestarts,LoadState,MainPID")
    last = output_of(["journalctl", "-u", name, "-n", "1", "-o", "cat", "--no-pager", "-q"])
    return {
        "active": facts.get("ActiveState", "unknown") if facts.get("LoadState") == "loaded" else "not loaded",
        "detail": facts.get("SubState", ""),
        "restarts": int(facts["NRestarts"]) if facts.get("NRestarts", "").isdigit() else 0,
        "says": facts.get("StatusText") or (last or "").strip()[:200],
        "runs": _runs(facts.get("MainPID", ""), prefix),
    }


def unit_facts(name: str, wanted: str) -> dict[str, str]:
    """Return the properties `wanted` of a systemd unit, in commas; empty without systemd."""
    output = output_of(["systemctl", "show", "-p", wanted, name])
    return dict(line.partition("=")[::2] for line in (output or "").splitlines())


def _runs(pid: str, prefix: Path) -> list[str]:
    """Return the releases of the libraries that a process has loaded; none if that cannot be told."""
    try:
        maps = Path("/proc", pid, "maps").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    # not what the link names now: the kernel tells the file that was opened
    return sorted(set(re.findall(re.escape(f"{prefix.resolve()}/releases/") + "([^/\n]+)/", maps)))


def _restart(prefix: Path) -> str:
    """Link the current release's units into systemd and restart them; return the error, or empty.

    Units of the role that the release before gave this machine are ended.
    """
    units, there = _units(prefix), [unit for unit in UNITS if _is_ours(prefix, SYSTEMD / unit)]
    if not there:
        return ""
    others = [unit for unit in there if unit not in units]
    calls = [["systemctl", "disable", "--now", *others]] if others else []
    calls += [["systemctl", "daemon-reload"]]
    calls += [["systemctl", "enable", *units]] if not set(units) <= set(there) else []
    for unit in units:
        shutil.copyfile(str(prefix / CURRENT / "units" / unit), str(SYSTEMD / unit))
    for words in (*calls, ["systemctl", "restart", *_startable(prefix, units)]):
        done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
        if done.returncode != 0:
            return done.stdout.decode(errors="replace").strip()[-500:]
    for unit in others:
        (SYSTEMD / unit).unlink()
    return ""


def _is_ours(prefix: Path, unit: Path) -> bool:
    """Return whether an installed unit starts what is installed under this prefix."""
    return unit.is_file() and f"={prefix / CURRENT}/" in unit.read_text(encoding="utf-8", errors="replace")


def _startable(prefix: Path, units: Sequence[str]) -> list[str]:
    """Return the units that may start now: an agent is bound to the bring-up, and would start it too."""
    bringup = _json(prefix / CURRENT / VERSION).get("bringup")
    if (
        not isinstance(bringup, str)
        or not bringup
        or output_of(["systemctl", "is-active", bringup]) is not None
    ):
        return list(units)
    return [unit for unit in units if unit != AGENT]


def output_of(words: Sequence[str]) -> str | None:
    """Return a program's output; None if it is missing or fails."""
    try:
        done = subprocess.run(
            words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=10, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.decode(errors="replace") if done.returncode == 0 else None


@contextmanager
def _locked(prefix: Path, name: str) -> Iterator[None]:
    try:
        file = (prefix / name).open("w")
    except FileNotFoundError:
        raise Refused(f"nothing is installed under {prefix}") from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise Refused("another installation is running on this robot") from None
        yield


def _files(folder: Path) -> Iterator[Path]:
    """Yield the regular files in a folder."""
    for root, _, names in os.walk(str(folder)):
        for path in (Path(root) / name for name in names):
            if path.is_file() and not path.is_symlink():
                yield path


def _name(folder: Path, path: Path) -> str:
    return path.relative_to(folder).as_posix()


def _facts(path: Path) -> list[Any]:
    return [_digest(path), stat.S_IMODE(path.stat().st_mode)]


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            digest.update(block)
    return digest.hexdigest()


def _release(link: Path) -> str | None:
    """Return the name of the release that a link points to; None if there is no link."""
    return link.readlink().name if link.is_symlink() and link.exists() else None


def _json(path: Path) -> Answer:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


COMMANDS: dict[str, Callable[[Path, Answer], Answer]] = {
    "look": look,
    "receive": receive,
    "rollback": rollback,
    "status": status,
}


def main(command: str, arguments: str) -> int:
    """Run the command and answer; return the exit code."""
    os.umask(0o022)
    request = json.loads(arguments)
    prefix = Path(request["prefix"])
    try:
        answer = COMMANDS[command](prefix, request)
    except Refused as refused:
        answer = {"error": str(refused)}
    except (tarfile.TarError, EOFError):
        answer = {"error": "the transfer broke off; nothing was installed"}
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        full = error.errno in {errno.ENOSPC, errno.EDQUOT}
        answer = {"error": f"{'disk full' if full else error.strerror or error}{where}"}
    with suppress(BrokenPipeError):
        print(f"\n{MARK}{json.dumps(answer)}", flush=True)
    return 1 if "error" in answer else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
