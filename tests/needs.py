"""What a marked test needs of the machine: programs, rights, and whether they are there."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from functools import cache

PROGRAMS = {
    "namespaces": ("ip", "nft", "ss"),
    "mounts": ("mount", "umount", "losetup", "mkfs.ext4"),
    "ssh": ("sshd", "ssh", "ssh-keygen"),
    "systemd": ("systemd-analyze",),
    "shellcheck": ("shellcheck",),
    "browser": ("chromium",),
}
"""The programs that a test with this mark starts."""
PACKAGES = {
    "ip": "iproute2",
    "ss": "iproute2",
    "nft": "nftables",
    "mount": "mount",
    "umount": "mount",
    "losetup": "mount",
    "mkfs.ext4": "e2fsprogs",
    "sshd": "openssh-server",
    "ssh": "openssh-client",
    "ssh-keygen": "openssh-client",
    "systemd-analyze": "systemd",
    "shellcheck": "shellcheck",
    "chromium": "chromium",
}
"""Where Debian and Ubuntu keep them."""
ALSO = {"chromium": ("google-chrome", "google-chrome-stable", "chromium-browser")}
"""Other names of the same program."""


def find(program: str) -> str | None:
    """Path of a program, also where a user's PATH leaves out those for administrators."""
    path = os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"])
    names = (program, *ALSO.get(program, ()))
    return next(filter(None, (shutil.which(name, path=path) for name in names)), None)


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
    return {"namespaces": _no_namespaces, "mounts": _no_mounts}.get(mark, str)()


def _no_namespaces() -> str:
    if os.geteuid() != 0:
        return "root"
    name = f"probe{os.getpid()}"
    made = subprocess.run([path_of("ip"), "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode != 0:
        return f"the right to make network namespaces ({made.stderr.strip()})"
    subprocess.run([path_of("ip"), "netns", "delete", name], check=True)
    return ""


def _no_mounts() -> str:
    if os.geteuid() != 0:
        return "root"
    tried = ([path_of("losetup"), "--find"], [path_of("mount"), "-t", "tmpfs", "tmpfs", "FOLDER"])
    with tempfile.TemporaryDirectory() as folder:
        for command in tried:
            words = [folder if word == "FOLDER" else word for word in command]
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                return f"the right to mount disks ({done.stderr.strip()})"
        subprocess.run([path_of("umount"), folder], check=True)
    return ""
