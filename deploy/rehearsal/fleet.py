"""Every process of a mission, as its main function, on an engine: robots, watchdogs, agents, candidates."""

from __future__ import annotations

import itertools
import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PosixPath
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from formation.agent.core import Agent
from formation.agent.persistence.persistence import Persistence
from formation.agent.persistence.state import Json
from formation.agent.persistence.store import Store, state_in, state_line
from formation.agent.process import drive
from formation.agent.simulated.faults import Fault as SensorFault
from formation.agent.simulated.faults import with_faults
from formation.agent.simulated.plant import Moving
from formation.agent.simulated.simulated import World, host, kinematic
from formation.agent.watchdog.core import Watchdog
from formation.agent.watchdog.process import watch
from formation.deploy.fleet import access
from formation.deploy.rehearsal.air import LOCAL_DELAY, Air, Weather
from formation.deploy.rehearsal.engine import UPTIME, Engine, Machine, VirtualProcess
from formation.deploy.rehearsal.sides import Exchange, FleetPort, Permits, RobotPort
from formation.leader.core import Leader
from formation.leader.process import lead
from formation.mission.model import Mission
from formation.monitor.core import Monitor
from formation.monitor.process import MAX_WAITING_MESSAGES, MonitorLoop
from formation.monitor.recording.recorder import Recorder
from formation.ros2.ros_names import address
from formation.simulation.edges import Edges, formation_error

if TYPE_CHECKING:
    from formation.deploy.rehearsal.signing import Insider, Keys, Replayer

MONITOR = "monitor's machine"
"""No robot has a name with spaces."""
WorldName = Literal["kinematic", "mujoco"]
Plants = Callable[[Mission, Sequence[str], int], Mapping[str, Moving]]
START_SPREAD = 0.2
"""Processes start within this time [s]."""
BOOT = "rehearsed"
"""Boot id of all machines: none is switched off."""
WRITER_PATIENCE = 30.0
"""Longest time that an agent's own writer of files may take [s]; a healthy disk needs a thousandth of it."""


class FailingPath(PosixPath):
    """A path at which each text is cut off in the middle."""

    def write_text(self, data: str, *args: object, **options: object) -> int:  # noqa: ARG002
        """Write half of `data`. Raises OSError then."""
        super().write_text(data[: len(data) // 2], encoding="utf-8")
        raise OSError("the power was cut")


def cut_stops(robot: str, before: bytes) -> bytes:
    """Return what remains of an agent's file of stops if a write of the same stops is cut off."""
    with tempfile.TemporaryDirectory(prefix="power-cut-") as folder:
        store = Store(FailingPath(folder), robot)
        try:
            Path(store.stops).write_bytes(before)
            store.write_stops(json.loads(before))
            store.written(WRITER_PATIENCE)
            return store.read_stops() or b""
        finally:
            store.close()


@dataclass
class Disk:
    """The disk of one machine."""

    files: dict[str, bytes] = field(default_factory=dict)
    is_full: bool = False
    torn: bytes | None = None
    """The newest half written state."""


class AgentFiles:
    """The files of one agent: in place of `formation.agent.persistence.store.Store`."""

    def __init__(self, disk: Disk, robot: str) -> None:
        self.stops = Path(f"{robot}.stops.json")
        self.failure = ""
        """Why the newest write failed; empty if it did not."""
        self._stops_failed = False
        self.is_open = True
        """Whether its process lives; nothing is written afterwards."""
        self._disk, self._robot, self._state = disk, robot, f"{robot}.state"
        self.before = disk.files.get(self._state)
        """The saved state when this agent began."""
        self.restored_torn = False
        """Whether it took a half written state for a whole one."""

    @property
    def stops_failed(self) -> bool:
        """Whether the newest stops could not be written."""
        return self._stops_failed

    def written(self, patience: float) -> bool:  # noqa: ARG002 - this disk is fast
        """Whether the newest stops are written."""
        return not self._stops_failed

    def write_stops(self, stops: Json) -> None:
        """Write the stops."""
        self._write(self.stops.name, json.dumps(stops, allow_nan=False).encode())
        self._stops_failed = bool(self.failure)

    def write_state(self, state: Json) -> None:
        """Write the saved state over the one before, as the real file is written."""
        line = state_line(state)
        self._write(self._state, line + self._disk.files.get(self._state, b"")[len(line) :])

    def read_stops(self) -> bytes | None:
        """Return the stored stops; None if there are none."""
        return self._disk.files.get(self.stops.name)

    def read_state(self) -> bytes | None:
        """Return the saved state; None if there is none. Raises OSError if it is incomplete."""
        data = self._disk.files.get(self._state)
        state = None if data is None else state_in(data)
        self.restored_torn = state is not None and data == self._disk.torn
        return state

    def set_state_aside(self) -> Path | None:
        """Rename the saved state, so that no agent finds it."""
        state = self._disk.files.pop(self._state, None)
        return None if state is None else Path(f"{self._state}.failed")

    def tear(self) -> None:
        """Leave the newest state half written, and of the stops what a cut in the middle leaves."""
        data = self._disk.files.get(self._state)
        if data is not None:
            half = len(data) // 2
            self._disk.torn = self._disk.files[self._state] = data[:half] + b"0" * (len(data) - half)
        stops = self.read_stops()
        if stops is not None:
            self._disk.files[self.stops.name] = cut_stops(self._robot, stops)

    def _write(self, name: str, data: bytes) -> None:
        if not self.is_open:
            return
        self.failure = "no space left on device" if self._disk.is_full else ""
        if not self.failure:
            self._disk.files[name] = data


class CandidateTerms:
    """The term file of one candidate: a `formation.leader.process.TermFile`."""

    def __init__(self, disk: Disk, name: str) -> None:
        self.is_open = True
        """Whether its process lives; nothing is written afterwards."""
        self._disk, self._name = disk, f"{name}.term"

    def read(self) -> int:
        """Return the stored term; 0 if there is none."""
        return int(self._disk.files.get(self._name, b"0"))

    def save(self, term: int, mono: float) -> None:  # noqa: ARG002 - this disk is fast
        """Store `term`."""
        if self.is_open and not self._disk.is_full:
            self._disk.files[self._name] = b"%d" % term


class Watched(NamedTuple):
    """The monitor, its process and its buses."""

    monitor: Monitor
    process: VirtualProcess
    bus: FleetPort
    stage: RobotPort


class Fleet:
    """The processes of `mission`, and what they run on."""

    def __init__(
        self,
        mission: Mission,
        seed: int,
        weather: Weather,
        sensor_faults: Sequence[SensorFault],
        world: WorldName = "kinematic",
        *,
        signed: bool = False,
    ) -> None:
        """`signed`: orders are signed and verified. Raises ValueError for sensor faults in physics."""
        if sensor_faults and world != "kinematic":
            raise ValueError(f"a fault of kind {sensor_faults[0].kind}: needs the kinematic world")
        self.mission, self.engine = mission, Engine()
        self.air = Air(seed, lambda: self.engine.now, weather)
        self.fleet = Exchange(self.engine, self.air.ways, _permits(mission))
        self.local = Exchange(self.engine, lambda *_: (LOCAL_DELAY,))
        self.machines = {name: Machine(name) for name in (*mission.names, *mission.standbys, MONITOR)}
        self.disks = {name: Disk() for name in self.machines}
        self.agents: dict[str, tuple[Agent, VirtualProcess]] = {}
        """The newest agent of each robot, and its process."""
        self.candidates: dict[str, tuple[Leader, VirtualProcess]] = {}
        self.watchdogs: dict[str, VirtualProcess] = {}
        self.robots: dict[str, tuple[World, VirtualProcess]] = {}
        """What hosts each simulated robot, and its process."""
        self.watched: Watched | None = None
        """The monitor, if there is one."""
        self.rivals: dict[str, VirtualProcess] = {}
        """Second agents."""
        self.processes: list[VirtualProcess] = []
        """All that have ever been started."""
        self.keys = _keys(mission) if signed else None
        self.insiders: dict[str, Insider | Replayer] = {}
        """Robots that relay other orders than they receive, as long as they do."""
        self._edges = Edges(mission.graph)
        self.files: dict[str, AgentFiles | CandidateTerms] = {}
        """Those of the newest process of each name."""
        self._numbers = itertools.count()
        faults = {name: [one for one in sensor_faults if one.robot == name] for name in mission.followers}
        self.slips = world != "kinematic"
        """Whether wheels slip."""
        groups = _hosted_together(mission) if world == "kinematic" else [mission.followers]
        for group in groups:
            plants = with_faults(kinematic, [one for name in group for one in faults[name]])
            self._start_world(group, seed, plants if world == "kinematic" else _in_physics(mission, seed))
        starts = START_SPREAD / len(self.machines)
        for number, name in enumerate(mission.followers):
            self.engine.at(0.01 + starts * number, partial(self.start_robot, name))
        for number, name in enumerate(mission.candidates):
            self.engine.at(0.02 + starts * number, partial(self.start_candidate, name))

    def start_robot(self, name: str) -> None:
        """Start the agent of a robot and its watchdog."""
        self.start_watchdog(name)
        self.start_agent(name)

    def start_agent(self, name: str, mission: Mission | None = None) -> None:
        """Start an agent, with what is on its disk; `mission` replaces the fleet's."""
        files = AgentFiles(self.disks[name], name)
        self.files[name] = files
        verifier = None if self.keys is None else self.keys.verifier()
        agent = Agent(
            mission or self.mission,
            name,
            publisher_id=self._publisher_id(name),
            certificate=verifier.carry if verifier else _no_certificate,
        )
        process = self._process(f"agent {name}", name, name)
        process.plug(self._fleet_port(process), self._robot_port(process, name))
        self.agents[name] = agent, process
        self._tamper(name)
        persistence = Persistence(agent, files, BOOT)
        process.play(drive(agent, process, persistence=persistence, verifier=verifier))

    def forge(self, name: str, *, forges: bool) -> None:
        """Have a robot relay forged orders, or relay what it receives again. Needs signed orders."""
        if forges and self.keys is not None:
            self.insiders[name] = self.keys.insider(name)
        else:
            self.insiders.pop(name, None)
        self._tamper(name)

    def record(self, name: str) -> Replayer:
        """Have a robot record the orders that it relays, to relay them again. Needs signed orders."""
        from formation.deploy.rehearsal.signing import Replayer  # noqa: PLC0415 - an optional package

        replayer = self.insiders[name] = Replayer(name)
        self._tamper(name)
        return replayer

    def _tamper(self, name: str) -> None:
        insider = self.insiders.get(name)
        self.agents[name][1].bus.tamper = None if insider is None else insider.tamper

    def start_rival(self, name: str) -> None:
        """Start a second agent of a robot, which has no disk."""
        process = self._process(f"second agent {name}", name, name)
        process.plug(self._fleet_port(process), self._robot_port(process, name))
        agent = Agent(self.mission, name, publisher_id=self._publisher_id(name))
        self.rivals[name] = process
        process.play(drive(agent, process))

    def start_watchdog(self, name: str) -> None:
        """Start the watchdog of a robot."""
        process = self.watchdogs[name] = self._process(f"watchdog {name}", name)
        process.plug(None, self._robot_port(process, name))
        process.play(watch(Watchdog(self.mission, name), process))

    def start_candidate(self, name: str) -> None:
        """Start the leader or a standby."""
        terms = CandidateTerms(self.disks[name], name)
        self.files[name] = terms
        signer = None if self.keys is None else self.keys.signer(name)
        verifier = None if self.keys is None or signer is None else self.keys.verifier(signer.certificate)
        leader = Leader(
            self.mission, name, publisher_id=self._publisher_id(name), known=terms.read(), signer=signer
        )
        process = self._process(f"leader {name}", name, name)
        process.plug(self._fleet_port(process), None)
        self.candidates[name] = leader, process
        process.play(lead(leader, process, verifier, terms.save))

    def start_monitor(self, recorder: Recorder | None) -> None:
        """Start the monitor, which records with `recorder`."""
        process = VirtualProcess(
            self.engine,
            "monitor",
            self.machines[MONITOR],
            MAX_WAITING_MESSAGES,
            wakes=False,
            certified=access.MONITOR,
        )
        self.processes.append(process)
        hosts = list(dict.fromkeys(host for _, host in self.robots.values()))
        bus, stage = self._fleet_port(process), RobotPort(self.local, process, hosts)
        process.plug(bus, stage)
        monitor = Monitor(self.mission, self.robots)
        watch = MonitorLoop(monitor, bus, recorder, stage, clock=process.clock, tend=process.tend)
        watch.declare()
        self.watched = Watched(monitor, process, bus, stage)
        process.play(watch.run(process.stop, snapshots=False))

    def process_of(self, name: str) -> VirtualProcess:
        """The agent of a robot, or the process of a candidate."""
        return (self.candidates if name in self.mission.candidates else self.agents)[name][1]

    def start(self, name: str) -> None:
        """Start the agent of a robot, or a candidate."""
        if name in self.mission.candidates:
            self.start_candidate(name)
        else:
            self.start_agent(name)

    def kill(self, name: str) -> None:
        """Kill the agent of a robot, or a candidate."""
        self.files[name].is_open = False
        self.process_of(name).kill()

    def tear(self, name: str) -> None:
        """Kill the agent of a robot in the middle of a write of its state."""
        self.kill(name)
        files = self.files[name]
        if isinstance(files, AgentFiles):
            files.tear()

    @property
    def leading(self) -> Leader:
        """The candidate that leads, else the one that did last."""
        leaders = [leader for leader, process in self.candidates.values() if process.alive]
        every = [leader for leader, _ in self.candidates.values()]
        return max(leaders or every, key=lambda one: (one.leads, one.term))

    def orphaned(self, name: str) -> bool:
        """Whether a robot has a watchdog that runs, and no agent that does."""
        watchdog, rival, agent = self.watchdogs.get(name), self.rivals.get(name), self.agents.get(name)
        led = (agent is not None and agent[1].runs) or (rival is not None and rival.runs)
        return watchdog is not None and watchdog.runs and not led

    def error(self) -> float:
        """True formation error in the shape that is wanted [m]."""
        slots = np.array(self.leading.wanted.slots(self.mission))
        return float(formation_error(self._edges, np.array(self._points()), slots))

    def discs(self) -> list[tuple[str, complex, float]]:
        """Each robot's name, true centre [m] and radius [m]."""
        found = []
        for name, (world, _) in self.robots.items():
            world.plant(name).go_to(UPTIME + self.engine.now)
            found.append((name, world.plant(name).position, self.mission.robots[name].radius))
        return found

    def _points(self) -> list[complex]:
        places = {name: position for name, position, _ in self.discs()}
        points = [self.leading.where(UPTIME + self.engine.now)]
        for name in self.mission.followers:
            offset = self.mission.robots[name].control_point_offset
            points.append(places[name] + offset * self.robots[name][0].plant(name).heading)
        return points

    def _start_world(self, names: Sequence[str], seed: int, plants: Plants) -> None:
        world = World(self.mission, names, seed, plants)
        process = self._process(f"robot {' '.join(names)}", names[0])
        fleet = any(address(key).topic.side != "robot" for key in world.subscriptions)
        process.plug(self._fleet_port(process) if fleet else None, RobotPort(self.local, process, []))
        for name in names:
            self.robots[name] = world, process
        process.play(host(world, process))

    def _process(self, name: str, machine: str, certified: str | None = None) -> VirtualProcess:
        process = VirtualProcess(self.engine, name, self.machines[machine], certified=certified)
        self.processes.append(process)
        return process

    def _fleet_port(self, process: VirtualProcess) -> FleetPort:
        return FleetPort(self.fleet, process)

    def _robot_port(self, process: VirtualProcess, name: str) -> RobotPort:
        return RobotPort(self.local, process, [self.robots[name][1]])

    def _publisher_id(self, name: str) -> str:
        return f"{name}-{next(self._numbers)}"


def _permits(mission: Mission) -> Permits:
    """Return the access rules of the field."""
    put = {(one.sender, one.receiver, one.key) for one in access.permissions(mission) if one.message == "put"}

    def permits(sender: str | None, receiver: str | None, key: str) -> bool:
        return sender is None or receiver is None or (sender, receiver, key) in put

    return permits


def _no_certificate(_mono: float) -> str:
    return ""


def _keys(mission: Mission) -> Keys:
    """Raises ModuleNotFoundError without cryptography."""
    from formation.deploy.rehearsal.signing import Keys  # noqa: PLC0415 - an optional package

    return Keys(mission)


def _in_physics(mission: Mission, seed: int) -> Plants:
    """Return what makes all robots on one floor, with mass and wheels that slip."""
    # MuJoCo reads this when it is loaded: a rehearsal needs no renderer
    os.environ.setdefault("MUJOCO_GL", "disable")
    from formation.agent.simulated.physics import world  # noqa: PLC0415 - an optional package

    return partial(world.wheeled, world.World(mission, seed))


def _hosted_together(mission: Mission) -> list[tuple[str, ...]]:
    """Return the robots that one process must simulate: those that see each other with a sensor."""
    specs = [mission.robots[name] for name in mission.followers]
    if any(spec.scanner != "none" or spec.measurement == "local" for spec in specs):
        return [mission.followers]
    return [(name,) for name in mission.followers]
