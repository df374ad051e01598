"""A picture of the physics world, without a window: by EGL or OSMesa, as MUJOCO_GL says."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import mujoco
from PIL import Image

from formation.agent.simulated import simulated
from formation.agent.simulated.physics.world import World, wheeled
from formation.mission.model import Mission

WIDTH, HEIGHT = 1280, 960
"""[pixels]"""
MARGIN = 0.25
"""Margin around the outermost robots [m]."""
CAMERA_DISTANCE_RATIO = 1.35
"""Distance of the camera, as a share of the width that it shows."""
ELEVATION = -35.0
"""Elevation of the camera's view [deg]."""
AZIMUTH = 70.0
"""Azimuth of the camera's view, counter-clockwise from the world's x axis [deg]."""
LIGHT = (-1.6, -2.0, 4.0)
"""Position of the light relative to the camera's target [m]: shadows are correct only near it."""


class NoPicture(Exception):  # noqa: N818 - nothing can be rendered here
    """This machine cannot render; the text says what it lacks."""


class Camera:
    """Shows a world obliquely from above, with all its robots in the picture."""

    def __init__(self, world: World) -> None:
        """Raises NoPicture where nothing can be rendered."""
        self._world = world
        try:
            self._renderer = mujoco.Renderer(world.model, HEIGHT, WIDTH)
        except Exception as error:  # noqa: BLE001 - whatever OpenGL's many parts raise
            raise NoPicture(f"nothing can be rendered here: {type(error).__name__}: {error}") from None

    def save(self, path: Path) -> None:
        """Write a picture of the present world. Raises OSError if it cannot be written."""
        where = [state.position for state in self._world.states.values()]
        east, north = [at.real for at in where], [at.imag for at in where]
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = (0.5 * (min(east) + max(east)), 0.5 * (min(north) + max(north)), 0.0)
        camera.distance = CAMERA_DISTANCE_RATIO * (
            2.0 * MARGIN + max(max(east) - min(east), max(north) - min(north))
        )
        camera.azimuth, camera.elevation = AZIMUTH, ELEVATION
        self._renderer.update_scene(self._world.data, camera)
        for light in self._renderer.scene.lights[: self._renderer.scene.nlight]:
            if not light.headlight:
                light.pos = camera.lookat + LIGHT
        Image.fromarray(self._renderer.render()).save(path, format="PNG")

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()


def in_physics(
    mission: Mission, seed: int, picture: Path | None
) -> tuple[simulated.World, Callable[[], None]]:
    """Return all robots of the mission in one physics world, and a function that writes the `picture`.

    Raises ValueError if nothing can be rendered, or for what cannot be simulated here.
    """
    world = World(mission, seed)
    hosted = simulated.World(mission, None, seed, partial(wheeled, world))
    if picture is None:
        return hosted, lambda: None
    try:
        camera = Camera(world)
    except NoPicture as why:
        raise ValueError(f"--picture {picture}: {why}") from None

    def leave_a_picture() -> None:
        camera.save(picture)
        camera.close()

    return hosted, leave_a_picture
