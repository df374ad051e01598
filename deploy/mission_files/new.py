"""`formation new`: write a mission from a shape and a number of robots."""

from __future__ import annotations

import argparse
import cmath
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple

from formation.deploy.arguments import add_json, add_out, number, parser, print_result, whole
from formation.deploy.mission_files.files import check_out, write_mission
from formation.deploy.refusal import Refusal
from formation.mission.file import parse
from formation.mission.model import Collisions, Mission
from formation.slots.measuring import measured
from formation.slots.shapes import MAX_SIDES, SHAPES, polygon

MAX_ROBOTS = 200
MIN_SLOT_RADII = 4.5
"""Least distance between slots [body radii]: from there on the collision filter allows every shape."""
COLLISIONS = Collisions()
"""Default settings of the collision filter; new missions state them."""
SETTLED_EDGE_ERROR = 0.0005
"""Mean error per edge below which a formation of more than a hundred edges counts as settled [m]."""
AVOID_ALL = 12
"""Largest number of robots that all avoid all; of more, each avoids those in the slots around its own."""
AVOIDED_SPACINGS = 2.1
"""Largest distance of those slots [spacings]: starts are drawn up to half a spacing off slots."""
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""Angle from one start's offset to the next [rad]: starts look random but are reproducible."""
EXAMPLES = """\
  formation new wedge --robots 7                       into wedge_7.toml
  formation new grid --robots 12 --spacing 0.8 --out field.toml
  formation new polygon --robots 9 --corners 3         a triangle
  formation new circle --robots 6 --robot paper        the paper's robots, gains and limits
  formation new wedge --robots 7 --avoid               robots that publish to all that may come near

The robots are robot1, robot2, …; a leader without a body goes ahead of them, or in their middle.
"""


class Profile(NamedTuple):
    """A kind of robots, with suitable values."""

    spacing: float
    """[m]"""
    radius: float
    """[m]"""
    tables: str
    """Text of [law] and [robot]."""
    speed: float
    """The leader's speed [m/s]."""
    lag: float = 0.0
    """Time constant with which it follows commands [s]."""
    simulated: str = ""
    """Text of [simulated_robot]; bodies are ideal without it."""


PROFILES = {
    "turtlebot3_burger": Profile(
        spacing=0.9,
        radius=0.105,
        speed=0.05,
        lag=0.1,
        tables="""\
[law]                        # for `--law paper`; the default, `field`, takes `gain` instead
k_p = 2.0                    # [1/s]
k_i = 0.2                    # [1/s²]

[robot]                      # TurtleBot3 Burger; every robot, unless its own table says otherwise
control_point_offset = 0.05  # L [m]
max_speed = 0.2108           # [m/s], what its firmware keeps to
max_turn_rate = 2.635        # [rad/s]
radius = 0.105               # of a circle that holds the body [m]
rate = 20                    # of its odometry [Hz]
cmd_vel = "twist_stamped"    # Jazzy; "twist" for Humble
odometry_frame = "start"     # its odometry begins with zero where it is switched on: on its start pose
speed_step = 0.01            # its node cuts commands to hundredths,
turn_rate_step = 0.01        # which error feedback makes up for
scanner = "required"         # its LDS-01: what it sees it avoids, and without scans it holds
scan = { model = "lds_01", x = -0.032, margin = 0.05 }   # mounted 32 mm behind the axle
seen = { radius = 0.035, x = -0.032 }   # scanners see each other's scanners and nothing else of a robot
""",
        simulated="""
[simulated_robot]
profile = "turtlebot3_burger"
""",
    ),
    "paper": Profile(
        spacing=1.0,
        radius=0.1,
        speed=0.2,
        tables="""\
[law]                        # section 4 of the paper, for `--law paper`; `field` takes `gain` instead
k_p = 2.0                    # [1/s]
k_i = 1.0                    # [1/s²]

[robot]                      # every robot, unless its own table says otherwise
control_point_offset = 0.2   # L [m]
max_speed = 1.5              # [m/s]
max_turn_rate = 1.5          # [rad/s]
radius = 0.1                 # of a circle that holds the body [m]
rate = 20                    # of its odometry [Hz]
""",
    ),
}
"""Profiles by name, the default first."""


class Draft(NamedTuple):
    """The requested mission."""

    shape: str
    robots: int
    spacing: float
    """[m]"""
    profile: str
    corners: int | None
    """Corners of a polygon; None for the default."""
    avoid: bool
    """Whether robots avoid others by the positions that these publish, which takes more links."""

    @property
    def slots(self) -> tuple[complex, ...]:
        """Slots of all robots, as in the file [m; from the leader, x ahead]."""
        if self.shape == "polygon":
            slots = polygon(self.robots, self.spacing, self.corners)
        else:
            slots = SHAPES[self.shape](self.robots, self.spacing)
        return tuple(complex(round(slot.real, 6), round(slot.imag, 6)) for slot in slots)

    @property
    def command(self) -> str:
        """The command that makes this mission."""
        corners = "" if self.corners is None else f" --corners {self.corners}"
        return (
            f"formation new {self.shape} --robots {self.robots}{corners} --spacing {self.spacing:g} "
            f"--robot {self.profile}{' --avoid' if self.avoid else ''}"
        )


def main(arguments: Sequence[str]) -> int:
    """Write a mission; return the exit code."""
    options = _options().parse_args(arguments)
    draft = _draft(options)
    out = options.out or Path(f"{options.shape}_{options.robots}.toml")
    check_out(out, force=options.force)
    written = text(draft)
    mission = parse(written, str(out))
    write_mission(out, written)
    print_result(options, words(draft, mission, out), lambda: report(draft, mission, out))
    return 0


def words(draft: Draft, mission: Mission, out: Path) -> str:
    """Return what was written, and the next commands."""
    deepest = max(hops or 0 for hops in mission.graph.depths)
    hops = f"{deepest} hop{'' if deepest == 1 else 's'} to the leader at most"
    file = quote(str(out))
    return f"""\
{out}: {draft.robots} robots in a {draft.shape}, {draft.spacing:g} m apart, {hops}

next:
  formation check {file}
  formation simulate {file} --runs 100
  formation run {file}"""


def report(draft: Draft, mission: Mission, out: Path) -> dict[str, Any]:
    """Return what was written, for a script."""
    return {
        "file": str(out),
        "mission": mission.name,
        "shape": draft.shape,
        "robots": draft.robots,
        "spacing": draft.spacing,
        "profile": draft.profile,
        "edges": sum(map(len, mission.graph.neighbours)),
        "depth": max(hops or 0 for hops in mission.graph.depths),
    }


def text(draft: Draft) -> str:
    """Return the whole mission file."""
    profile, slots = PROFILES[draft.profile], draft.slots
    graph = measured((0j, *slots))
    bound = max(0.05, SETTLED_EDGE_ERROR * sum(map(len, graph.neighbours)))
    where = "round" if draft.shape in {"circle", "polygon"} else "behind"
    avoids_all = 'avoid = "all"                # every robot that comes near\n'
    avoided = avoids_all if draft.avoid and draft.robots <= AVOID_ALL else ""
    placed = "".join(
        f"robot{i} = [{_metres(slot.real)}, {_metres(slot.imag)}]\n" for i, slot in enumerate(slots, 1)
    )
    spread = min(0.5 * draft.spacing, 1.0)
    return f"""\
# {draft.robots} robots in a {draft.shape}, {draft.spacing:g} m apart, {where} a leader without a body. From:
#
#   {draft.command}
#
# Any single robot may be lost, and the others go on: `formation check` says how.
# `formation assign` chooses slots and neighbours anew.
name = "{draft.shape}-{draft.robots}"
leader = "leader"
duration = 60                # of `formation run` [s]
settled = {bound:<18g} # formation error under which it counts as settled, summed over edges [m]
turning = true               # slots are relative to the leader's heading: x ahead, y to the left

{profile.tables}{avoided}
[collisions]
margin = {COLLISIONS.margin:<19g} # room that is kept between two bodies [m]
lag = {profile.lag:<22g} # time constant with which robots follow commands [s]
noise = {COLLISIONS.noise:<20g} # of robots' positions, standard deviation per axis [m]
delay = {COLLISIONS.delay:<20g} # positions of others may be so late [s]

# [bounds]                   # your room, world frame [m]: outside it a robot holds, and orders that lead out
# x = [-5.0, 20.0]           # are refused. Without it the bounds are wide: `formation check` says which
# y = [-5.0, 5.0]

[shapes.{draft.shape}]{" " * max(1, 20 - len(draft.shape))}# control points relative to the leader's [m]
{placed}
[robots.leader]              # a point that goes along the route
start = {{ x = 0.0, y = 0.0 }}
{"".join(_robots(draft, graph.neighbours, graph.fallbacks))}
[[route]]                    # the leader's: one endless leg, straight on
speed = {profile.speed:<20g} # [m/s]
heading_deg = 0
{profile.simulated}
[simulation]
spread = {spread:<19g} # `formation simulate --runs` draws starts within ± this of each slot [m]
"""


def _robots(
    draft: Draft, neighbours: tuple[tuple[int, ...], ...], fallbacks: tuple[tuple[int, ...], ...]
) -> Iterator[str]:
    """Yield the robots' tables. Each starts off its slot, by less than would make two bodies touch."""
    radius = PROFILES[draft.profile].radius
    offset = min(0.25 * (draft.spacing - 2.0 * radius), 0.5)
    for place, slot in enumerate(draft.slots, 1):
        start = slot + cmath.rect(offset, GOLDEN_ANGLE * place)
        heading = round(60.0 * math.sin(GOLDEN_ANGLE * place * place))
        yield f"\n[robots.robot{place}]\nneighbours = [{_quoted_names(neighbours[place])}]\n"
        if fallbacks[place]:
            yield f"fallback_neighbours = [{_quoted_names(fallbacks[place])}]\n"
        if nearby := _nearby(draft, place, {*neighbours[place], *fallbacks[place]}):
            yield f"avoid = [{_quoted_names(nearby)}]\n"
        x, y = _metres(round(start.real, 3)), _metres(round(start.imag, 3))
        yield f"start = {{ x = {x}, y = {y}, heading_deg = {heading} }}\n"


def _nearby(draft: Draft, place: int, measured: set[int]) -> tuple[int, ...]:
    """Return the robots that may come near, besides those that it measures."""
    if not draft.avoid or draft.robots <= AVOID_ALL:
        return ()
    here, reach = draft.slots[place - 1], AVOIDED_SPACINGS * draft.spacing
    near = [other for other, slot in enumerate(draft.slots, 1) if abs(slot - here) <= reach]
    return tuple(other for other in near if other != place and other not in measured)


def _quoted_names(robots: tuple[int, ...]) -> str:
    return ", ".join(f'"robot{i}"' if i else '"leader"' for i in robots)


def _metres(value: float) -> str:
    return repr(value + 0.0)  # no -0.0


def _draft(options: argparse.Namespace) -> Draft:
    """Return the checked request."""
    profile = PROFILES[options.robot]
    spacing = profile.spacing if options.spacing is None else options.spacing
    least = MIN_SLOT_RADII * profile.radius
    if spacing < least:
        raise Refusal(
            f"--spacing {spacing:g}: must be at least {least:g} m for robots of radius {profile.radius:g} m"
        )
    if options.shape == "polygon" and options.robots < 3:
        raise Refusal(f"--robots {options.robots}: a polygon needs at least 3")
    if options.corners is not None:
        if options.shape != "polygon":
            raise Refusal(f"--corners {options.corners}: only a polygon has corners, not a {options.shape}")
        if options.corners > options.robots:
            raise Refusal(
                f"--corners {options.corners}: must be from 3 to the number of robots, {options.robots}"
            )
    return Draft(options.shape, options.robots, spacing, options.robot, options.corners, options.avoid)


def _options() -> argparse.ArgumentParser:
    options = parser("new", "Write a mission: any number of robots in a shape, ready to run.", EXAMPLES)
    options.add_argument("shape", metavar="SHAPE", choices=SHAPES, help=", ".join(SHAPES))
    options.add_argument(
        "--robots",
        type=whole(2, MAX_ROBOTS),
        required=True,
        metavar="N",
        help=f"how many, 2 to {MAX_ROBOTS}",
    )
    spacings = ", ".join(f"{profile.spacing:g} for {name}" for name, profile in PROFILES.items())
    least = ", ".join(f"{MIN_SLOT_RADII * profile.radius:g}" for profile in PROFILES.values())
    options.add_argument(
        "--spacing",
        type=number(0.0, 100.0, "m", open_below=True),
        metavar="M",
        help=f"between neighbouring slots [m] (default {spacings}; at least {least})",
    )
    options.add_argument(
        "--robot",
        choices=PROFILES,
        default=next(iter(PROFILES)),
        help="kind of robots, with its limits (default %(default)s)",
    )
    options.add_argument(
        "--corners",
        type=whole(3),
        metavar="K",
        help=f"of a polygon (default {MAX_SIDES}, or as many as there are robots)",
    )
    options.add_argument(
        "--avoid",
        action="store_true",
        help="robots avoid all others that may come near, by the positions that these publish: more links "
        "than the graph needs (`formation check` counts them)",
    )
    add_out(options, "file to write (default SHAPE_N.toml, here)")
    options.add_argument("--force", action="store_true", help="overwrite an existing file")
    add_json(options)
    return options
