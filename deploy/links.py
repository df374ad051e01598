"""Links of a command with a fleet that runs."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from formation.deploy.refusal import refusing
from formation.mission.file import configuration_of
from formation.mission.model import Mission
from formation.transport import wiring
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusError
from formation.transport.runtime.flags import bus_config
from formation.transport.wiring import Links


@contextmanager
def operator_bus(options: argparse.Namespace, mission: Mission, names: Iterable[str]) -> Iterator[Bus]:
    """Yield the operator's bus: it dials `names`, unless the flags of `add_links` say otherwise.

    In a folder of bundles it takes the operator's configuration. Raises Refusal.
    """
    options.config = options.config or configuration_of(options.mission, OPERATOR)
    where = wiring.endpoints(mission).agents
    links = Links((), tuple(where[name] for name in names))
    with refusing(BusError), Bus(bus_config(options, mission, links, OPERATOR)) as bus:
        yield bus


def no_answer_message(mission: Mission, options: argparse.Namespace, visitor: str) -> str:
    """Return the message, and remedies, if no process answers; `visitor` has the configuration needed."""
    ends = options.connect or list(wiring.endpoints(mission).agents.values())
    where = "" if options.config else f" at {ends[0]}{f' … {ends[-1]}' if len(ends) > 1 else ''}"
    tries = [f"does it run here? formation run {shlex.quote(options.mission)}"]
    if not options.connect:
        tries.append(
            "a run prints its -e flags if the usual ports were taken; a field has those of its robots"
        )
    else:
        tries.append("are these the endpoints of agents and leader, and does a firewall let this machine in?")
    if options.config is None:
        tries.append(f"robots under certificates answer only the {visitor}: -c FILE names its configuration")
    else:
        tries.append(
            f"is {options.config} the {visitor}'s, of this fleet, and not expired? formation doctor says"
        )
    if mission.team:
        tries.append(f"the mission's team is {mission.team!r}: messages of other teams do not arrive here")
    return "\n".join([f"no process answers{where}", *(f"  - {one}" for one in tries)])
