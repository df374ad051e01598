"""What a marked test needs of the machine: programs, rights, and whether they are there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from importlib.util import find_spec

import pytest

PROGRAMS = {
    "namespaces": ("ip", "nft", "ss"),
    "mounts": ("mount", "umount", "losetup", "mkfs.ext4"),
    "ssh": ("sshd", "ssh", "ssh-keygen"),
    "systemd": ("systemd-analyze",),
    "shellcheck": ("shellcheck",),
    "browser": ("chromium",),
}
"""The programs that a test with this mark starts."""
MARKS = (*PROGRAMS, "physics", "rendering")
"""The marks of tests that need something of the machine."""
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


def leave_out_without(mark: str) -> None:
    """Leave out the module that calls this if what its mark needs is not here, and may be lacking."""
    lacking = missing(mark)
    if lacking and os.environ.get("FORMATION_TEST_ALL") != "1":
        pytest.skip(f"all of it needs {lacking}", allow_module_level=True)


@cache
def missing(mark: str) -> str:
    """What a test with this mark lacks on this machine; empty if nothing."""
    for program in PROGRAMS.get(mark, ()):
        if find(program) is None:
            return f"{program} (apt install {PACKAGES[program]})"
    more = {
        "namespaces": _no_namespaces,
        "mounts": _no_mounts,
        "physics": _no_physics,
        "rendering": _no_rendering,
    }
    return more.get(mark, str)()


def _no_physics() -> str:
    return "" if find_spec("mujoco") else "MuJoCo (pip install '.[physics]')"


def _no_rendering() -> str:
    if lacking := _no_physics():
        return lacking
    words = [sys.executable, "-c", "import mujoco; mujoco.GLContext(8, 8).make_current()"]
    tried = subprocess.run(words, env={"MUJOCO_GL": "egl", **os.environ}, capture_output=True, check=False)
    return "" if tried.returncode == 0 else "EGL (apt install libegl1)"


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
