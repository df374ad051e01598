"""The power is cut while it records: what the disk itself holds then has all but the last second.

The disk is a file, mounted as an ext4. What its blocks hold at some moment is what is in that file, which is
copied while the recorder runs; what only the operating system has is not there. That file is in memory, so
it does not matter how busy the disks of this machine are.
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
"""What a power cut may take [s], besides what the disk takes to write."""


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
    print("lost, and while the disk was copied", [(f"{lost:.2f}", f"{took:.3f}") for lost, took in losses])
    assert max(lost for lost, _ in losses) <= LOSS


def cut(image: Path, copy: Path, notes: Path) -> tuple[float, float]:
    """Take what the disk holds now; how much is missing of what the recorder had, how long it took [s]."""
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
