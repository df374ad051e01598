"""The physics world as MuJoCo reads it: floor, walls, posts and robots.

Wheels and casters touch the floor only; decks and scanners touch each other, walls and posts. To the floor a
wheel is a ball, which touches it in one point, so the track is what it says.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from formation.agent.simulated.physics.chassis import Chassis, Deck

STEP_TIME = 0.002
"""One step of the engine [s]."""
HEIGHT, THICKNESS = 0.5, 0.02
"""Height of walls and posts, thickness of walls [m]."""
Post = tuple[complex, float]
"""An upright cylinder: its axis and its radius [m; world frame]."""
Wall = tuple[complex, complex]
"""A straight wall from one point to another [m; world frame]."""


class Placed(NamedTuple):
    """A robot and its initial pose."""

    chassis: Chassis
    position: complex
    """Middle of the axle [m; world frame]."""
    heading: complex
    """Unit complex [world frame]."""
    wheel_radii: tuple[float, float]
    """True radii of the wheels, left and right [m]."""


def mjcf(robots: Mapping[str, Placed], posts: Iterable[Post], walls: Iterable[Wall]) -> str:
    """The world in MuJoCo's XML: robot NAME is body NAME/base, joints and motors NAME/left, NAME/right."""
    bodies = "".join(_robot(name, one) for name, one in robots.items())
    motors = "".join(_motors(name, one.chassis) for name, one in robots.items())
    return f"""
<mujoco>
  <option timestep="{STEP_TIME}" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <visual>
    <global offwidth="1280" offheight="960"/>
    <quality shadowsize="4096" offsamples="8"/>
    <headlight ambient="0.4 0.4 0.4" diffuse="0.2 0.2 0.2" specular="0 0 0"/>
  </visual>
  <default>
    <default class="floor"><geom contype="1" conaffinity="2"/></default>
    <default class="rolling"><geom contype="2" conaffinity="1" mass="0" solref="0.005 1"/></default>
    <default class="body"><geom contype="4" conaffinity="4" mass="0" friction="0.3 0 0"/></default>
    <default class="seen"><geom contype="0" conaffinity="0" mass="0" group="1"/></default>
  </default>
  <asset>
    <texture name="tiles" type="2d" builtin="checker" width="512" height="512"
      rgb1=".84 .84 .85" rgb2=".74 .74 .76"/>
    <material name="tiles" texture="tiles" texrepeat="1 1" texuniform="true"/>
  </asset>
  <worldbody>
    <light dir="0.4 0.5 -1" directional="true" diffuse="0.55 0.55 0.55" specular="0.1 0.1 0.1"/>
    <geom class="floor" type="plane" size="0 0 1" material="tiles"/>
    {"".join(_post(*one) for one in posts)}
    {"".join(_wall(*one) for one in walls)}
    {bodies}
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>"""


def _post(at: complex, radius: float) -> str:
    return (
        f'<geom class="body" type="cylinder" rgba="0.6 0.35 0.2 1" size="{radius} {HEIGHT / 2}"'
        f' pos="{at.real} {at.imag} {HEIGHT / 2}"/>'
    )


def _wall(begin: complex, end: complex) -> str:
    middle, way = 0.5 * (begin + end), end - begin
    return (
        f'<geom class="body" type="box" rgba="0.5 0.5 0.5 1" pos="{middle.real} {middle.imag} {HEIGHT / 2}"'
        f' size="{abs(way) / 2} {THICKNESS / 2} {HEIGHT / 2}" quat="{_quaternion(way)}"/>'
    )


def _robot(name: str, placed: Placed) -> str:
    """The base's frame is in the middle of the axle, on the floor."""
    one, at = placed.chassis, placed.position
    scanner = 0.5 * (one.lds.bottom + one.lds.top)
    base_moments = " ".join(map(str, one.moments))
    mass = one.mass + one.lds_mass
    x = (one.mass * one.centre[0] + one.lds_mass * one.lds.x) / mass
    z = (one.mass * one.centre[1] + one.lds_mass * scanner) / mass
    sides = ""
    if one.sides is not None:
        length, width, height = one.sides
        sides = (
            f'<geom class="body" type="box" size="{length / 2} {width / 2} {height / 2}"'
            f' pos="0 0 {height / 2 + one.deck.bottom}" rgba="0 0 0 0"/>'
        )
    return f"""
    <body name="{name}/base" pos="{at.real} {at.imag} 0" quat="{_quaternion(placed.heading)}">
      <freejoint/>
      <inertial pos="{x} 0 {z}" mass="{mass}" diaginertia="{base_moments}"/>
      {_deck(one.deck, "0.25 0.4 0.65 1")}
      {_deck(one.lds, "0.1 0.1 0.1 1")}
      {_nose(one.deck)}
      {sides}
      {"".join(_caster(one, x) for x in one.casters)}
      {_wheel(f"{name}/left", one, 0.5 * one.track, placed.wheel_radii[0])}
      {_wheel(f"{name}/right", one, -0.5 * one.track, placed.wheel_radii[1])}
    </body>"""


def _deck(deck: Deck, colour: str) -> str:
    return (
        f'<geom class="body" type="cylinder" size="{deck.radius} {(deck.top - deck.bottom) / 2}"'
        f' pos="{deck.x} 0 {(deck.top + deck.bottom) / 2}" rgba="{colour}"/>'
    )


def _nose(deck: Deck) -> str:
    """Return a mark that shows the front in a picture."""
    length, x = 0.25 * deck.radius, deck.x + 0.7 * deck.radius
    return (
        f'<geom class="seen" type="box" rgba="1 0.8 0.2 1" size="{length} {0.2 * length} {0.1 * length}"'
        f' pos="{x} 0 {deck.top}"/>'
    )


def _caster(one: Chassis, x: float) -> str:
    ball = 0.25 * one.wheel_radius
    return (
        f'<geom class="rolling" type="sphere" size="{ball}" pos="{x} 0 {ball}"'
        f' friction="{one.glide} 0 0" solref="{one.give} 1" priority="1"/>'
    )


def _wheel(name: str, one: Chassis, y: float, radius: float) -> str:
    across, about = one.wheel_moments
    return f"""
      <body pos="0 {y} {radius}">
        <joint name="{name}" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="{one.wheel_mass}" diaginertia="{across} {about} {across}"/>
        <geom class="rolling" type="sphere" size="{radius}"
          friction="{one.grip} 0 0" priority="1" rgba="0 0 0 0"/>
        <geom class="seen" type="cylinder" size="{radius} {0.27 * radius}"
          zaxis="0 1 0" rgba="0.1 0.1 0.1 1"/>
      </body>"""


def _motors(name: str, one: Chassis) -> str:
    return "".join(
        f'<velocity name="{name}/{side}" joint="{name}/{side}" kv="{one.gain}"'
        f' forcerange="{-one.torque} {one.torque}"/>'
        for side in ("left", "right")
    )


def _quaternion(heading: complex) -> str:
    half = cmath.sqrt(heading / abs(heading))
    return f"{half.real} 0 0 {half.imag}"
