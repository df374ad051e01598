"""Rules of where robots and leaders are: bounds, what scanners see, robots without an agent, rests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from formation.agent.simulated.faults import SIZES as SENSOR_KINDS
from formation.agent.simulated.faults import Fault
from formation.control.tracker import FRESH_PERIODS
from formation.deploy.rehearsal.engine import UPTIME
from formation.deploy.rehearsal.fleet import Fleet
from formation.mission.model import Mission
from formation.slots.geofence import Area

ORPHAN_TIME = 1.0
"""Time after the watchdog's limit within which a robot without an agent must stand [s]."""
AT_REST_STEP = 1e-4
"""Motion between two checks up to which a robot stands [m]."""
Tell = Callable[[str, str, str], None]
"""``tell(rule, robot, what)``"""
Discs = Sequence[tuple[str, complex, float]]
"""Name, true centre [m] and radius [m] of each robot."""


class Places:
    """What the true positions of one fleet's robots break."""

    def __init__(self, fleet: Fleet, faults: Iterable[Fault], tell: Tell) -> None:
        self._fleet, self._tell = fleet, tell
        mission = fleet.mission
        kinds = {one.kind for one in faults}
        self._area = Area.of(mission)
        self._knows_place = not kinds & (SENSOR_KINDS.keys() | {"restart"}) and not fleet.slips
        self._carried = {one.robot for one in faults if one.kind == "carried"}
        self._seeing = [name for name in mission.followers if mission.robots[name].scanner != "none"]
        self._orphaned: dict[str, float] = {}  # since when each robot has a watchdog and no agent [s]
        self._at: dict[str, complex] = {}  # newest true position [m]
        # the leader at the newest check, its term, ids of the stop and the hold in force: new after a run,
        self._leads: tuple[str, int, str, str] = "", 0, "", ""
        self._led: complex | None = None  # and where it was; None if the fleet was to run [m]

    def look(self, discs: Discs, *, touches: bool) -> None:
        """Check the robots at `discs`; `touches`: what they see must not be touched."""
        self._check_leader()
        for name, here, radius in discs:
            before, self._at[name] = self._at.get(name, here), here
            self._check_orphan(name, abs(here - before))
            breach = self._area.breach(here, name)
            if self._knows_place and breach.excess > 0.0:
                self._tell("bounds", name, breach.words)
            if touches and name in self._seeing and (depth := radius - room(self._fleet.mission, here)) > 0.0:
                self._tell("touch", name, f"its body overlaps what it sees by {depth:.3f} m")

    def _check_leader(self) -> None:
        leader = self._fleet.leading
        rest, before, self._led = leader.plan.team_mode.rest, self._led, None
        now_leads = leader.name, leader.term, rest.stop, rest.hold
        _, process = self._fleet.candidates.get(leader.name, (leader, None))
        if process is not None and process.runs and leader.leads and leader.mode != "run":
            self._led = leader.where(UPTIME + self._fleet.engine.now)
            moved = 0.0 if before is None or now_leads != self._leads else abs(self._led - before)
            if moved > AT_REST_STEP:
                self._tell("zero", leader.name, f"leads on while its fleet is to {leader.mode}")
        self._leads = now_leads

    def _check_orphan(self, name: str, moved: float) -> None:
        now = self._fleet.engine.now
        if not self._fleet.orphaned(name):
            self._orphaned.pop(name, None)
            return
        since = self._orphaned.setdefault(name, now)
        limit = FRESH_PERIODS / self._fleet.mission.robots[name].rate + ORPHAN_TIME
        pushed = name in self._carried or self._fleet.slips
        if now - since > limit and moved > AT_REST_STEP and not pushed:
            self._tell("watchdog", name, f"drives {now - since:.1f} s after its agent")


def room(mission: Mission, here: complex) -> float:
    """Distance to the nearest post or wall of the simulated world [m]; infinite without any."""
    world = mission.simulation
    posts = [abs(complex(one.x, one.y) - here) - one.radius for one in world.posts]
    return min([*posts, *(_from_line(here, *one.line) for one in world.walls)], default=float("inf"))


def _from_line(here: complex, begin: complex, end: complex) -> float:
    along = end - begin
    share = ((here - begin) * along.conjugate()).real / abs(along) ** 2
    return abs(begin + min(max(share, 0.0), 1.0) * along - here)
