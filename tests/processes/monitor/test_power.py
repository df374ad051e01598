"""A power cut while recording: the disk itself then has all messages but those of the last second.

The disk is a file, mounted as ext4. A copy of that file, made while the recorder runs, has the blocks of the
disk at that time, without what only the operating system has. The file is in memory, so busy disks of this
machine do not matter.
"""

from __future__ import annotations

import random
import shutil
import time
from pathlib import Path

import pytest

from formation.monitor.recording.reader import read
from tests.processes.monitor.test_killed import Notes, message, started, wait_until_given
from tests.support.disks import in_a_file, in_memory, mounted, run

pytestmark = [pytest.mark.mounts, pytest.mark.processes, pytest.mark.timeout(300)]
CUTS = 10
LOSS = 1.0
"""Greatest loss by a power cut [s], apart from the time that the disk takes to write."""


def test_power_cut_loses_at_most_a_second(tmp_path: Path) -> None:
    choice, losses = random.Random(4), list[tuple[float, float]]()
    with in_memory(200_000_000) as memory, in_a_file(memory / "disk", 64) as folder:
        image = memory / "disk"
        path = folder / "new" / "folders" / "run.mcap"
        with started(path, tmp_path / "notes"):
            wait_until_given(tmp_path / "notes", 2000)
            for number in range(CUTS):
                time.sleep(choice.uniform(0.1, 0.7))
                losses.append(cut(image, memory / f"cut{number}", tmp_path / "notes"))
    print("lost, time of copying", [(f"{lost:.2f}", f"{took:.3f}") for lost, took in losses])
    assert max(lost for lost, _ in losses) <= LOSS


def cut(image: Path, copy: Path, notes: Path) -> tuple[float, float]:
    """Copy the disk as it is now; return the loss in this copy and the time of copying [s]."""
    noted = Notes(notes)
    count = noted.given()
    begun = time.monotonic()
    run("cp", "--sparse=always", image, copy)
    took = time.monotonic() - begun
    with mounted("-o", "loop", copy) as folder:
        kept = list(read(folder / "new" / "folders" / "run.mcap").messages())
        shutil.rmtree(folder / "new")
    copy.unlink()
    assert [one.sample[:3] for one in kept] == [message(number)[:3] for number in range(len(kept))]
    assert len(kept) > 500
    return noted.age(len(kept), count), took
