"""The points of a goal or a path of ROS, at most as many as a route may have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from formation.ros2.messages import WORLD_FRAME, Path, Pose, decode
from formation.wire import BadMessage, Sample

MAX_WAYPOINTS = 300
"""Most points of a route; of a longer path those are left out that are closest to the line between others."""
THINNING_TOLERANCE = 0.005
"""Least distance from that line within which points are left out [m]; doubled as often as needed."""
MAX_TOLERANCE = 0.08
"""Greatest such distance [m]: a path that needs more is not followed, as it would pass through obstacles."""


def waypoints(sample: Sample, paths: str | None) -> list[complex]:
    """Return the points of a goal or, on the topic `paths`, of a path [m]. Raises BadMessage."""
    if paths is None or sample.key != paths.strip("/"):
        goal = decode(Pose, sample.payload)
        _check_frame(goal.frame)
        return [goal.position]
    path = decode(Path, sample.payload)
    _check_frame(path.frame)
    points = list(path.positions)
    if not points:
        raise BadMessage("the path has no points")
    tolerance, whole = THINNING_TOLERANCE, points
    while len(points) > MAX_WAYPOINTS:
        if tolerance > MAX_TOLERANCE:
            raise BadMessage(
                f"the path winds too much: with {MAX_WAYPOINTS} of its {len(whole)} points, the most, a route"
                f" is over {MAX_TOLERANCE:g} m off; plan a shorter one"
            )
        points, tolerance = thinned(whole, tolerance), 2.0 * tolerance
    return points


def thinned(points: Sequence[complex], tolerance: float) -> list[complex]:
    """Return a path without points that are within `tolerance` [m] of it without them (Douglas-Peucker).

    It ends early, within milliseconds, if more than `MAX_WAYPOINTS` are left.
    """
    whole, kept, open_parts = np.array(points), {0, len(points) - 1}, [(0, len(points) - 1)]
    while open_parts and len(kept) <= MAX_WAYPOINTS:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        chord, way = whole[last] - whole[first], whole[first + 1 : last] - whole[first]
        part = np.clip((way * chord.conjugate()).real / max(abs(chord) ** 2, 1e-12), 0.0, 1.0)
        off = np.abs(way - part * chord)
        farthest = int(np.argmax(off))
        if off[farthest] > tolerance:
            middle = first + 1 + farthest
            kept.add(middle)
            open_parts += [(first, middle), (middle, last)]
    return [points[number] for number in sorted(kept)]


def _check_frame(frame: str) -> None:
    """Raise BadMessage for points in another frame than the world's, such as RViz's fixed frame odom."""
    if frame.removeprefix("/") not in {"", WORLD_FRAME}:
        raise BadMessage(f"counts in frame {frame}, must be {WORLD_FRAME}")
