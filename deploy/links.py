"""Links of a command with a fleet that runs."""

from __future__ import annotations

import argparse
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
