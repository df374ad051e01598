"""The robots of a physics world, ready to be hosted by `formation.agent.simulated`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from formation.agent.simulated import simulated
from formation.agent.simulated.physics.picture import Camera, NoPicture
from formation.agent.simulated.physics.wheeled import wheeled
from formation.agent.simulated.physics.world import World
from formation.mission.model import Mission


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
