"""What a marked test needs of the machine: programs, rights, and whether they are there."""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import cache

PROGRAMS = {
    "namespaces": ("ip", "nft", "ss"),
    "ssh": ("sshd", "ssh", "ssh-keygen"),
    "systemd": ("systemd-analyze",),
    "shellcheck": ("shellcheck",),
}
"""The programs that a test with this mark starts."""
PACKAGES = {
    "ip": "iproute2",
    "ss": "iproute2",
    "nft": "nftables",
    "sshd": "openssh-server",
    "ssh": "openssh-client",
    "ssh-keygen": "openssh-client",
    "systemd-analyze": "systemd",
    "shellcheck": "shellcheck",
}
"""Where Debian and Ubuntu keep them."""


def find(program: str) -> str | None:
    """Path of a program, also where a user's PATH leaves out those for administrators."""
    path = os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"])
    return shutil.which(program, path=path)


def path_of(program: str) -> str:
    """Path of a program that a mark has promised to be there."""
    found = find(program)
    assert found is not None, f"there is no {program} here: is the test marked as one that needs it?"
    return found


@cache
def missing(mark: str) -> str:
    """What a test with this mark lacks on this machine; empty if nothing."""
    for program in PROGRAMS.get(mark, ()):
        if find(program) is None:
            return f"{program} (apt install {PACKAGES[program]})"
    return _no_namespaces() if mark == "namespaces" else ""


def _no_namespaces() -> str:
    if os.geteuid() != 0:
        return "root"
    name = f"probe{os.getpid()}"
    made = subprocess.run([path_of("ip"), "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode != 0:
        return f"the right to make network namespaces ({made.stderr.strip()})"
    subprocess.run([path_of("ip"), "netns", "delete", name], check=True)
    return ""
