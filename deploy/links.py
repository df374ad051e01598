"""Links of a command with a fleet that runs."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from formation.deploy.refusal import refuse_errors
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
    with refuse_errors(BusError), Bus(bus_config(options, mission, links, OPERATOR)) as bus:
        yield bus


def no_answer_message(mission: Mission, options: argparse.Namespace, visitor: str) -> str:
    """Return the message, and remedies, if no process answers; `visitor` has the configuration needed."""
    ends = options.connect or list(wiring.endpoints(mission).agents.values())
    where = "" if options.config else f" at {ends[0]}{f' … {ends[-1]}' if len(ends) > 1 else ''}"
    named = shlex.quote(options.mission)
    if options.config is not None:
        tries = [
            f"formation doctor {named} says which robots can be reached, and why others cannot",
            f"it says also whether {options.config} is the {visitor}'s, of this fleet, and not expired",
        ]
    else:
        ports = (
            "see that these are the endpoints of agents and leader, and that no firewall is between"
            if options.connect
            else "a run that found its usual ports taken has printed the -e flags that are needed here"
        )
        tries = [f"if it does not run yet: formation run {named}", ports, wiring.certificate_remedy(visitor)]
        if wiring.under_certificates(ends):  # a fleet in the field, which does not run on this machine
            tries = [wiring.certificate_remedy(visitor), ports]
    if mission.team:
        tries.append(f"the mission's team is {mission.team!r}: messages of other teams do not arrive here")
    return "\n".join([f"no process answers{where}", *(f"  - {one}" for one in tries)])
