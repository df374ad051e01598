"""Gathers what can be known at the desk: what robots say of themselves, and whether they can be dialled."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from deploy.doctor import files, listening, machine
from deploy.doctor.agents import VOICE
from deploy.doctor.facts import Certificate, Facts
from deploy.doctor.leading import LEADS, YES
from deploy.doctor.probe import Papers, reach
from deploy.refusal import Refusal
from formation.mission import Mission
from formation.ros2.messages import Status
from formation.topics import STATUS
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.wiring import Links, endpoints, members

LINKED = 2.0
"""How much longer links may take, as long as somebody has not been heard [s]."""
OPERATOR = "operator"


def gather(
    mission: Mission,
    robots: Sequence[str],
    seconds: float,
    config: Path | None,
    papers: Papers | None,
    folder: Path | None,
) -> list[Facts]:
    """Facts about each of `robots`, standbys among them.

    `config` is the operator's, `folder` the mission's certificates.
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
            early = listening.listen(bus, LINKED, keys.values())
            heard = listening.listen(bus, seconds)
    except BusError as error:
        raise Refusal(str(error)) from None
    for key, samples in early.items():
        heard.setdefault(key, [])[:0] = samples
    with ThreadPoolExecutor(max_workers=16) as pool:
        reached = dict(zip(robots, pool.map(lambda end: reach(end, papers), dialled), strict=True))
    statuses = {name: listening.statuses(heard.get(key, [])) for name, key in keys.items()}
    told = {name: said for name, (_, said) in statuses.items() if said is not None}
    return [
        Facts(
            mission=mission,
            robot=name,
            on_robot=False,
            seconds=seconds,
            status=stream,
            said=said,
            reached={name: reached[name]},
            certificates=certificates.get(name),
            doubled=_doubled(name, told),
            wall=time.time(),
        )
        for name, (stream, said) in statuses.items()
    ]


def desk(mission: Mission, papers: Papers | None, others: Sequence[Facts]) -> Facts:
    """Facts about the desk itself, the operator's certificate and this machine's clock, and who leads."""
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
    told = {one.robot: one.said.values for one in others if one.said is not None}
    return tuple(name for name in mission.candidates if told.get(name, {}).get(LEADS) == YES)


def _certificates(mission: Mission, folder: Path | None) -> dict[str, tuple[Certificate, ...]]:
    if folder is None:
        return {}
    read = {name: files.read(name, one) for name, one in files.papers_in(folder, members(mission))}
    return {name: (one,) for name, one in read.items() if one is not None}


def _doubled(robot: str, told: Mapping[str, Status]) -> tuple[str, ...]:
    return tuple(name for name, said in told.items() if VOICE + robot in said.values)
