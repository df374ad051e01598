"""Warnings where a mission's own route and shapes leave its bounds."""

from __future__ import annotations

import math
from collections.abc import Iterator

from formation.mission.model import Mission
from formation.mission.route import Route
from formation.slots.geofence import HORIZON_TIME, Geofence
from formation.slots.shape import PlacedShape


def warnings(mission: Mission) -> Iterator[str]:
    """A route that ends at the bounds within `HORIZON_TIME`, and shapes refused at the start."""
    fence, route = Geofence(mission), Route.of(mission)
    first = fence.exit(route, PlacedShape.first(mission)._replace(rotation=0.0))
    ends = route.total if math.isfinite(route.total) else HORIZON_TIME
    if first is not None and first.time <= ends:
        yield (
            f"the route leaves the bounds after {first.time:.4g} s, where {first.words}: the leader "
            "stops there; change [[route]], or widen [bounds]"
        )
    start = mission.robots[mission.leader].start.position
    for shape in mission.shapes:
        if shape == mission.first_shape:
            continue
        placed_shape = PlacedShape.first(mission)._replace(mix=((shape, 1.0),))
        worst = fence.breach([placed_shape], start, fence.clearance)
        if worst.excess > 0.0:
            yield f"shape {shape} leaves the bounds at the start, and is refused there: {worst.words}"
