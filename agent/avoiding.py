"""Out of whose way a robot gets, and what the collision filter makes of what the law wants.

It minds the bodies of those whom it may measure and of those whom its mission has it mind; of the latter it
hears positions for nothing else. And whatever its range scan sees that is none of them, if it has one. Who
has fallen silent is taken to stand anywhere between where it was last seen and where its velocity would have
carried it before its failsafe stops it, for as long as this agent runs: it may well have died at once. Of who
was never heard nothing is known; the status names it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from agent.localisation import Localisation
from agent.neighbourhood import Neighbour, Neighbourhood
from agent.scanner import HORIZON, Scanner
from formation import scan
from formation.avoidance import LAG, Manners, Obstacle, brake
from formation.detour import Avoidance, avoid
from formation.mission import Mission
from formation.neighbour import unknown
from formation.scan import Circle, Mate
from formation.unicycle import Command
from formation.wire import Now
from formation.zones import Zone

RECOGNISED = 0.2
"""Who may be further off than this [rad] from where it is looked for is not taken out of a scan: a post that
stands there would be taken for it."""
Brake = Callable[[Command], Command]
"""What leaves everybody room of a command."""


class Avoiding:
    """One robot's collision filter."""

    def __init__(self, mission: Mission, robot: str, law: str) -> None:
        """The printed law is said as it is: nothing comes between it and the robot."""
        spec, minded = mission.robots[robot], mission.minded(robot)
        self.mode = mission.collisions.mode if law == "field" else "off"
        self.others = {
            name: Neighbour(mission, name, mission.robots[name].rate)
            for name in minded
            if name not in spec.measurable and self.mode != "off"
        }
        """Those whom it minds without measuring them."""
        self.scanner = Scanner(mission, robot) if spec.scanner != "none" else None
        """What is in the way whoever it is; its protective zones do not ask for the mode or the law."""
        self.memory = Avoidance()
        self.avoided = 0
        """So many commands were changed, or would have been."""
        self.acting = False
        """Whether the newest was."""
        self._minded = minded if self.mode != "off" else ()
        self._specs = {name: mission.robots[name] for name in minded}
        self._first = {name: mission.has_right_of_way(name, robot) for name in minded}
        self._local = spec.measurement == "local"
        self._limits = spec.limits
        rules = mission.collisions
        self._manners = Manners(spec.radius, rules.room, spec.longest_command + LAG * rules.lag, rules.blind)
        self._apart, self._delay = rules.room, rules.delay

    def command(
        self, wanted: Command, along: complex, here: Localisation, around: Neighbourhood, now: Now, dt: float
    ) -> tuple[Command, Brake | None]:
        """What to do instead of `wanted` for `dt` [s].

        Those it follows move `along` [m/s; body frame]. And what is to be made of any other command that
        comes about of it.
        """
        if not self._minded and self.scanner is None:
            return wanted, None
        known = self._known(around)
        obstacles = {name: self._obstacle(name, one, here, now) for name, one in known.items()}
        strangers = self._strangers(obstacles, known, now)
        minded, done = [*obstacles.values(), *self._seen(strangers)], wanted
        if self.mode != "off":
            done, self.memory = avoid(wanted, minded, self._manners, self._limits, along, self.memory, dt)
        self.acting = done != wanted
        self.avoided += self.acting
        braked = minded if self.mode == "on" else []

        def safe(command: Command) -> Command:
            command = brake(command, braked, self._manners)
            return command if self.scanner is None else self.scanner.guarded(command, strangers, now)

        return done if self.mode == "on" else wanted, safe

    @property
    def blind_at(self) -> float:
        """When a scanner that is required counts as silent, if nothing comes [s, monotonic]."""
        return (
            self.scanner.stream.stale_at if self.scanner is not None and self.scanner.required else math.inf
        )

    def rested(self) -> None:
        """The robot does not drive: nothing keeps it from moving."""
        self.memory, self.acting = self.memory._replace(kept=0.0, detour=0.0, side=0.0), False
        if self.scanner is not None:
            self.scanner.zone = Zone.CLEAR

    def words(self, around: Neighbourhood) -> dict[str, str]:
        """What the status says of it."""
        said = {}
        if self._minded or (self.scanner is not None and self.mode != "off"):
            unseen = set(self._minded).difference(self._known(around))
            does = "gets out of the way" if self.mode == "on" else "would get out of the way"
            said = {
                "collisions": f"{self.mode}: {does if self.acting else 'clear'}",
                "minds": ", ".join(self._minded),
                **({"minds unseen": ", ".join(sorted(unseen))} if unseen else {}),
                "avoided": str(self.avoided),
                "deadlocks": str(self.memory.deadlocks),
            }
        if self.scanner is not None:
            said["protective zone"] = str(self.scanner.zone)
        return said

    def doubt_all(self) -> None:
        """Trust nothing that was heard: this process was frozen."""
        for one in self.others.values():
            one.stream.doubt()
        if self.scanner is not None:
            self.scanner.stream.doubt()

    def _known(self, around: Neighbourhood) -> dict[str, Neighbour]:
        """Those who were heard, or seen, at least once."""
        all_of_them = {name: self.others.get(name) or around.each[name] for name in self._minded}
        return {name: one for name, one in all_of_them.items() if one.stream.arrived is not None}

    def _strangers(
        self, obstacles: Mapping[str, Obstacle], known: Mapping[str, Neighbour], now: Now
    ) -> list[Circle]:
        """What is seen and is nobody who is minded anyway, because it tells where it is [body frame]."""
        if self.scanner is None:
            return []
        mates = [
            Mate(name, one.at, one.radius, one.velocity)
            for name, one in obstacles.items()
            if self.mode == "on" and known[name].stream.fresh(now) and one.doubt < RECOGNISED
        ]
        return self.scanner.strangers(now, mates)

    def _seen(self, strangers: Sequence[Circle]) -> Iterator[Obstacle]:
        # what it goes round it passes at the distance that its protective zones ask for
        wider = 0.0 if self.scanner is None else max(0.0, self.scanner.margin - self._apart)
        for one in scan.obstacles(strangers, HORIZON):
            yield one._replace(radius=one.radius + wider)

    def _sensed(self, name: str) -> bool:
        """Whether a sensor sees it, which does not mind which way the robot faces in the world."""
        return self._local and name not in self.others

    def _obstacle(self, name: str, one: Neighbour, here: Localisation, now: Now) -> Obstacle:
        spec, sensed = self._specs[name], self._sensed(name)
        there = one.around(now, here.stream.age(now), body=not sensed)
        # a sensor sees the control point; the centre is somewhere around it
        mine, facing, radius = here.position, here.course.conjugate(), spec.radius
        if sensed:
            mine, facing = here.point, here.heading.conjugate()
            radius += spec.control_point_offset
        since = unknown(there.age, self._delay, spec.top_speed, there.last - mine, there.at - mine)
        return Obstacle(
            facing * (there.at - mine) + (self._limits.offset if sensed else 0.0),
            radius + there.unsure + since.nearer,
            facing * there.velocity,
            self._first[name],
            stands=not one.fresh(now),
            doubt=0.0 if sensed else here.course_doubt,
            age=since.age,
            unsure=since.aside,
        )
