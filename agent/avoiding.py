"""Out of whose way a robot gets, and what the collision filter makes of what the law wants.

It minds the bodies of those whom it may measure and of those whom its mission has it mind; of the latter it
hears positions for nothing else. Who has fallen silent is taken to be within what it can have moved of where
it was last seen, for as long as this agent runs: what is not heard of may well stand there. Of who was never
heard nothing is known; the status names it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from agent.localisation import Localisation
from agent.neighbourhood import Neighbour, Neighbourhood
from formation.avoidance import LAG, Avoidance, Manners, Obstacle, avoid, brake
from formation.mission import Mission
from formation.neighbour import uncertain
from formation.unicycle import Command
from formation.wire import Now

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
        self._manners = Manners(
            spec.radius, mission.collisions.margin, spec.longest_command + LAG * mission.collisions.lag
        )

    def command(
        self, wanted: Command, along: complex, here: Localisation, around: Neighbourhood, now: Now, dt: float
    ) -> tuple[Command, Brake | None]:
        """What to do instead of `wanted` for `dt` [s].

        Those it follows move `along` [m/s; body frame]. And what is to be made of any other command that
        comes about of it.
        """
        if not self._minded:
            return wanted, None
        known = self._known(around)
        obstacles = [self._obstacle(name, one, here, now) for name, one in known.items()]
        doubt = 0.0 if all(self._sensed(name) for name in known) else here.course_doubt
        done, self.memory = avoid(
            wanted, obstacles, self._manners, self._limits, along, doubt, self.memory, dt
        )
        self.acting = done != wanted
        self.avoided += self.acting
        if self.mode == "warn":
            return wanted, None
        return done, partial(brake, obstacles=obstacles, manners=self._manners, doubt=doubt)

    def rested(self) -> None:
        """The robot does not drive: nothing keeps it from moving."""
        self.memory, self.acting = self.memory._replace(kept=0.0, detour=0.0), False

    def words(self, around: Neighbourhood) -> dict[str, str]:
        """What the status says of it."""
        if not self._minded:
            return {}
        unseen = set(self._minded).difference(self._known(around))
        does = "gets out of the way" if self.mode == "on" else "would get out of the way"
        return {
            "collisions": f"{self.mode}: {does if self.acting else 'clear'}",
            "minds": ", ".join(self._minded),
            **({"minds unseen": ", ".join(sorted(unseen))} if unseen else {}),
            "avoided": str(self.avoided),
            "deadlocks": str(self.memory.deadlocks),
        }

    def _known(self, around: Neighbourhood) -> dict[str, Neighbour]:
        """Those who were heard, or seen, at least once."""
        all_of_them = {name: self.others.get(name) or around.each[name] for name in self._minded}
        return {name: one for name, one in all_of_them.items() if one.stream.arrived is not None}

    def _sensed(self, name: str) -> bool:
        """Whether a sensor sees it, which does not mind which way the robot faces in the world."""
        return self._local and name not in self.others

    def _obstacle(self, name: str, one: Neighbour, here: Localisation, now: Now) -> Obstacle:
        spec, my_age = self._specs[name], here.stream.age(now)
        unsure = uncertain(one.stream.age(now), spec.top_speed)
        if self._sensed(name):
            # a sensor sees the control point; the centre is somewhere around it
            relative = here.heading.conjugate() * (one.point(now, my_age, carry=True) - here.point)
            return Obstacle(
                relative + self._limits.offset,
                spec.radius + spec.control_point_offset + unsure,
                here.heading.conjugate() * one.velocity,
                self._first[name],
            )
        at, velocity = one.body(now, my_age)
        facing = here.course.conjugate()
        return Obstacle(
            facing * (at - here.position), spec.radius + unsure, facing * velocity, self._first[name]
        )
