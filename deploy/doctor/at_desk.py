"""Gather facts at the desk: robots' statuses, and whether they can be dialled."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from formation.deploy.doctor import files, listening, machine
from formation.deploy.doctor.facts import Certificate, Facts
from formation.deploy.doctor.probe import Papers, reach
from formation.deploy.refusal import Refusal
from formation.mission.model import Mission
from formation.protocol.status import AgentStatus, LeaderStatus
from formation.topics import STATUS
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.wiring import Links, endpoints, members

LINK_TIME = 2.0
"""Additional time for links while nothing has come from a robot [s]."""
OPERATOR = "operator"


def gather(
    mission: Mission,
    robots: Sequence[str],
    seconds: float,
    config: Path | None,
    papers: Papers | None,
    folder: Path | None,
) -> list[Facts]:
    """Return facts about each of `robots`, which may include standbys.

    `config` is the operator's, `folder` has the mission's certificates.
    """
    certificates = _certificates(mission, folder)
    where = endpoints(mission).agents
    dialled = tuple(where[name] for name in robots)
    keys = {name: STATUS.key(name) for name in robots}
    try:
        with Bus(
            BusConfig(
                implied=Links((), dialled), namespace=mission.team or "", config_file=config, name=OPERATOR
            )
        ) as bus:
            for key in keys.values():
                bus.subscribe(key)
            early = listening.listen(bus, LINK_TIME, keys.values())
            received = listening.listen(bus, seconds)
    except BusError as error:
        raise Refusal(str(error)) from None
    for key, samples in early.items():
        received.setdefault(key, [])[:0] = samples
    with ThreadPoolExecutor(max_workers=16) as pool:
        reached = dict(zip(robots, pool.map(lambda end: reach(end, papers), dialled), strict=True))
    statuses = {
        name: listening.statuses(
            LeaderStatus if name in mission.candidates else AgentStatus, received.get(key, [])
        )
        for name, key in keys.items()
    }
    known = {name: newest for name, (_, newest) in statuses.items() if newest is not None}
    return [
        Facts(
            mission=mission,
            robot=name,
            on_robot=False,
            seconds=seconds,
            status=stream,
            newest_status=newest,
            reached={name: reached[name]},
            certificates=certificates.get(name),
            doubled=_doubled(name, known),
            wall=time.time(),
        )
        for name, (stream, newest) in statuses.items()
    ]


def desk(mission: Mission, papers: Papers | None, others: Sequence[Facts]) -> Facts:
    """Return facts about the desk: the operator's certificate, this machine's clock, and the leader."""
    own = None if papers is None else files.read(OPERATOR, papers)
    return Facts(
        mission=mission,
        robot=mission.leader,
        on_robot=False,
        seconds=0.0,
        certificates=None if own is None else (own,),
        chrony=machine.chrony(),
        leading=_leading(mission, others) if mission.standbys else None,
        wall=time.time(),
    )


def _leading(mission: Mission, others: Sequence[Facts]) -> tuple[str, ...]:
    leads = {
        one.robot for one in others if isinstance(one.newest_status, LeaderStatus) and one.newest_status.leads
    }
    return tuple(name for name in mission.candidates if name in leads)


def _certificates(mission: Mission, folder: Path | None) -> dict[str, tuple[Certificate, ...]]:
    if folder is None:
        return {}
    read = {name: files.read(name, one) for name, one in files.papers_in(folder, members(mission))}
    return {name: (one,) for name, one in read.items() if one is not None}


def _doubled(robot: str, known: Mapping[str, AgentStatus | LeaderStatus]) -> tuple[str, ...]:
    return tuple(
        name
        for name, newest in known.items()
        if isinstance(newest, AgentStatus) and robot in newest.contested
    )
