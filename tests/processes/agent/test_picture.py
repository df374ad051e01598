"""A picture of the physics world, rendered without a window."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support import needs

pytestmark = pytest.mark.rendering
needs.leave_out_without("rendering")

from PIL import Image  # noqa: E402 - only where there is MuJoCo

SCRIPT = """
import sys
from pathlib import Path
from formation.agent.simulated.physics.picture import in_physics
from formation.mission.file import load
_, at_the_end = in_physics(load("six_robots"), 0, Path(sys.argv[1]))
at_the_end()
"""


def test_picture_shows_robots_on_floor(tmp_path: Path) -> None:
    file = tmp_path / "end.png"
    # MuJoCo reads MUJOCO_GL when it is imported, which other tests may have done already
    words = [sys.executable, "-W", "error", "-c", SCRIPT, str(file)]
    subprocess.run(words, env={**os.environ, "MUJOCO_GL": "egl"}, check=True)
    with Image.open(file) as picture:
        assert picture.size == (1280, 960)
        red, _, blue = np.moveaxis(np.asarray(picture.convert("RGB"), dtype=np.int64), 2, 0)
    assert np.count_nonzero(blue > red + 40) > 500  # robots
    assert np.count_nonzero(abs(blue - red) < 10) > 100_000  # the floor
