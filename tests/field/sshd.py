"""An OpenSSH server for tests on loopback, with its own port, host key and authorised key."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from tests.support.child import PATIENCE, free_endpoint
from tests.support.needs import path_of

SEPARATION = Path("/run/sshd")
"""Empty folder that a server started by root needs for privilege separation; kept, as others may use it."""


class Server(NamedTuple):
    """A running server."""

    port: int
    options: tuple[str, ...]
    """Options with which `formation deploy push` logs in."""


@contextmanager
def sshd(folder: Path, *lines: str) -> Iterator[Server]:
    """Run a server for the current user, with more `lines` of configuration and its files in `folder`."""
    port = int(free_endpoint().rpartition(":")[2])
    for name in ("host", "client", "stranger"):
        words = [path_of("ssh-keygen"), "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)]
        subprocess.run(words, check=True)
    shutil.copy(folder / "client.pub", folder / "authorized_keys")
    known = (folder / "host.pub").read_text(encoding="utf-8").split()[:2]
    (folder / "known_hosts").write_text(f"[127.0.0.1]:{port} {' '.join(known)}\n", encoding="utf-8")
    config = folder / "sshd_config"
    settings = [
        f"ListenAddress 127.0.0.1:{port}",
        f"HostKey {folder / 'host'}",
        f"AuthorizedKeysFile {folder / 'authorized_keys'}",
        "PidFile none",
        "StrictModes no",  # sshd does not accept the modes of pytest's folders
        "UsePAM no",
        "PasswordAuthentication no",
        "MaxStartups 100",
        f"SetEnv PATH={Path(sys.base_prefix) / 'bin'}:{os.environ['PATH']}",  # bundles are for this Python
        *lines,
    ]
    config.write_text("\n".join(settings) + "\n", encoding="utf-8")
    if os.geteuid() == 0:
        SEPARATION.mkdir(mode=0o755, exist_ok=True)
    with (folder / "sshd.log").open("wb") as log:  # sshd starts only by its full path
        server = subprocess.Popen([path_of("sshd"), "-D", "-e", "-f", str(config)], stderr=log)
    try:
        _await(port, server, folder / "sshd.log")
        yield Server(port, tuple(_options(folder, port)))
    finally:
        server.terminate()
        server.wait(PATIENCE)


def _options(folder: Path, port: int) -> Iterator[str]:
    yield from ("--user", getpass.getuser())
    for option in (
        f"Port={port}",
        f"IdentityFile={folder / 'client'}",
        f"UserKnownHostsFile={folder / 'known_hosts'}",
        "IdentitiesOnly=yes",
    ):
        yield from ("--ssh-option", option)


def _await(port: int, server: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + PATIENCE
    while True:
        assert server.poll() is None, log.read_text(encoding="utf-8")
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return
        assert time.monotonic() < deadline, "the ssh server does not listen"
        time.sleep(0.01)
