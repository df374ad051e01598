"""Robots with two wheels, and the physics world as MuJoCo reads it: floor, walls, posts and robots.

Wheels and casters touch the floor only; decks and scanners touch each other, walls and posts. To the floor a
wheel is a ball, which touches it in one point, so the track is what it says.

The TurtleBot3 Burger after its published dimensions and URDF:

| number | why |
|---|---|
| wheels 33 mm, 160 mm apart; 138 × 178 × 192 mm; caster 81 mm behind the axle | published |
| 0.826 kg and its moments, wheels 28 g each, scanner 114 g, caster 5 g | its URDF; 1 kg in all |
| base's centre of mass 32 mm behind the axle, 60 mm up | the middle of the base |
| 4096 ticks a turn, 1 N m, 61 turns a minute | its servos' encoders, stall torque and speed at 12 V |
| distance by wheels, turns by gyroscope | as its node counts them |
| gyroscope off by 0.0001 rad/s | chosen |
| friction 1.0 of a wheel | chosen: rubber on a dry hard floor |
| friction 0.02 of a caster | chosen: a ball that rolls |
| each wheel's radius right to 0.05 % | chosen; odometry counts with the nominal one |
| servos follow within 30 ms, at 2 m/s² | chosen: from rest to full speed takes 0.1 s |

The URDF has the base's centre of mass on the axle: with its one caster behind, the robot would tip over
when it brakes. Its deck is nearly square; here it is a cylinder, with a box around the wheels.

Any other robot of a mission is made from its `radius`: the Burger's lengths scale with it, masses with its
cube, moments with its fifth and torques with its fourth power. Three things do not: its wheels may turn as
fast as the mission's limits require; they accelerate at half of what their grip allows; and the robot is
as wide as its bounding circle, and carries its weight low over the axle between two casters, which
accelerating from rest to 1.5 m/s in a third of a second requires.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from formation.mission.robot import RobotSpec

BURGER_RADIUS = 0.105
"""Radius of the circle around the middle of a Burger's axle that contains it [m]."""
TICKS_PER_TURN = 4096
"""Encoder ticks per turn."""
WHEEL_RADIUS_DEVIATION = 5e-4
"""Standard deviation of a wheel's radius, as a share of it."""

GYRO_BIAS = 1e-4
"""Standard deviation of a gyroscope's rate at rest [rad/s]."""
GRAVITY = 9.81
"""[m/s²]"""
GRIP_SHARE = 0.5
"""Share of the wheels' grip that a robot uses, if it is not a Burger."""
STEP_TIME = 0.002
"""One step of the engine [s]."""
HEIGHT, THICKNESS = 0.5, 0.02
"""Height of walls and posts, thickness of walls [m]."""
Post = tuple[complex, float]
"""An upright cylinder: its axis and its radius [m; world frame]."""
Wall = tuple[complex, complex]
"""A straight wall from one point to another [m; world frame]."""


class Deck(NamedTuple):
    """An upright cylinder that others can bump into."""

    x: float
    """Its axis ahead of the wheels' axle [m]."""
    radius: float
    """[m]"""
    bottom: float
    """[m above the floor]"""
    top: float
    """[m above the floor]"""


class Seen(NamedTuple):
    """The upright cylinder that other robots' scanners see."""

    x: float
    """Its axis ahead of the wheels' axle [m]."""
    radius: float
    """[m]"""


class Chassis(NamedTuple):
    """A robot with two driven wheels; x is ahead of the axle, z above the floor."""

    deck: Deck
    sides: tuple[float, float, float] | None
    """Length, width and height of the box around both wheels, if it reaches beyond the deck [m]."""
    lds: Deck
    """The scanner, which sees from the middle of its height."""
    wheel_radius: float
    """[m]"""
    track: float
    """Between the wheels [m]."""
    casters: tuple[float, ...]
    """Where a caster touches the floor, ahead of the axle [m]."""
    mass: float
    """Of the base, without wheels and scanner [kg]."""
    centre: tuple[float, float]
    """Centre of that mass: x and z [m]."""
    moments: tuple[float, float, float]
    """Of the base about its centre [kg m²]."""
    wheel_mass: float
    """[kg]"""
    wheel_moments: tuple[float, float]
    """Of a wheel: across its axle and about it [kg m²]."""
    lds_mass: float
    """[kg]"""
    torque: float
    """Maximum torque of a motor [N m]."""
    wheel_rate: float
    """Maximum speed of a motor [rad/s]."""
    acceleration: float
    """Greatest acceleration that a wheel's servo is commanded, at the rim [m/s²]."""
    grip: float = 1.0
    """Friction of a wheel."""
    glide: float = 0.02
    """Friction of a caster."""
    give: float = 0.03
    """Softness of a caster: time constant of its contact [s]. One as hard as the wheels would bounce."""
    response: float = 0.03
    """Response time of the servos [s]."""

    @property
    def weight(self) -> float:
        """Total mass [kg]."""
        return self.mass + 2.0 * self.wheel_mass + self.lds_mass

    @property
    def gain(self) -> float:
        """Torque of a motor per missing speed [N m s/rad]: each of two speeds up half of the robot."""
        return 0.5 * self.weight * self.wheel_radius**2 / self.response


def burger() -> Chassis:
    """The TurtleBot3 Burger. Its motors reach top speed or top turn rate, not both at once."""
    return Chassis(
        deck=Deck(-0.032, 0.070, 0.010, 0.153),
        sides=(0.066, 0.178, 0.066),
        lds=Deck(-0.032, 0.035, 0.153, 0.192),
        wheel_radius=0.033,
        track=0.160,
        casters=(-0.081,),
        mass=0.831,  # with the caster
        centre=(-0.032, 0.060),
        moments=(2.21e-3, 2.12e-3, 2.01e-3),
        wheel_mass=0.0285,
        wheel_moments=(1.12e-5, 2.07e-5),
        lds_mass=0.114,
        torque=1.0,
        wheel_rate=61.0 * 2.0 * math.pi / 60.0,
        acceleration=2.0,
    )


def scaled(radius: float, max_speed: float, max_turn_rate: float, seen: Seen) -> Chassis:
    """Return a robot of `radius` [m] with motors that reach both limits [m/s; rad/s] at once.

    `seen` is what stands at the height of its scanner.
    """
    size, one = radius / BURGER_RADIUS, burger()
    wheel_radius, track = one.wheel_radius * size, one.track * size
    return one._replace(
        deck=Deck(0.0, radius, one.deck.bottom * size, one.deck.top * size),
        sides=None,
        lds=Deck(*seen, one.lds.bottom * size, one.lds.top * size),
        wheel_radius=wheel_radius,
        track=track,
        casters=(-0.081 * size, 0.081 * size),
        mass=one.mass * size**3,
        centre=(0.0, 0.030 * size),
        moments=(one.moments[0] * size**5, one.moments[1] * size**5, one.moments[2] * size**5),
        wheel_mass=one.wheel_mass * size**3,
        wheel_moments=(one.wheel_moments[0] * size**5, one.wheel_moments[1] * size**5),
        lds_mass=one.lds_mass * size**3,
        torque=one.torque * size**4,
        acceleration=GRIP_SHARE * one.grip * GRAVITY,
        wheel_rate=(max_speed + 0.5 * track * max_turn_rate) / wheel_radius,
        give=0.06,  # it only keeps the robot upright: its load reduces that of the wheels
    )


def chassis_of(spec: RobotSpec, *, is_burger: bool) -> Chassis:
    """Return the construction of this robot of a mission."""
    if is_burger:
        return burger()
    seen = Seen(spec.seen.x, spec.radius if spec.seen.radius is None else spec.seen.radius)
    return scaled(spec.radius, spec.max_speed, spec.max_turn_rate, seen)


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
    middle, span = 0.5 * (begin + end), end - begin
    return (
        f'<geom class="body" type="box" rgba="0.5 0.5 0.5 1" pos="{middle.real} {middle.imag} {HEIGHT / 2}"'
        f' size="{abs(span) / 2} {THICKNESS / 2} {HEIGHT / 2}" quat="{_quaternion(span)}"/>'
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
