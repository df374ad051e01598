"""Other shapes while driving, ordered at any moment, also while one is still on its way."""

from __future__ import annotations

import random
import time

from tests.campaigns.document import Found
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.campaign import Options, campaign
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.seen import window
from tests.campaigns.reliability.trial import Judgement, Row, Times
from tests.support.namespaces import until

TITLE = "Shapes"
MISSION = "patrol"
SEQUENCE = ("hexagon", "line", "wedge")
LONGEST = 8.0  # the next shape is ordered at a random moment of so long after the one before [s]
ABOUT = """\
Hexagon, then line, then wedge while driving; each is ordered by `formation order`, at a random moment within
8 s of the one before, arrived or not. *Nearest* is the least distance between two robots' control points
meanwhile; *formed* is from the last order until the leader's shape is the wedge; *error back after* counts
from that order, in the shape as it moves."""


NAMES = ("shapes",)


def run(options: Options) -> Found:
    found, _ = campaign(options, lambda folder: Fleet(MISSION, folder), (ROW,))
    return found


def _change(fleet: Fleet, _victim: str) -> None:
    _order(fleet, SEQUENCE[0])
    until(lambda: _formed(fleet) == SEQUENCE[0], what=f"the shape is {SEQUENCE[0]}")
    for shape in SEQUENCE[1:]:
        time.sleep(random.uniform(0.0, LONGEST))
        _order(fleet, shape)


def _order(fleet: Fleet, shape: str) -> None:
    code, report = fleet.order("shape", shape)
    assert code == 0, report


def _formed(fleet: Fleet) -> str:
    fleet.seen.read_on()
    return fleet.seen.leads[-1].formed


def _verdict(fleet: Fleet, _victim: str, times: Times) -> Judgement:
    last = SEQUENCE[-1]
    try:
        until(lambda: _formed(fleet) == last)
    except AssertionError:
        return Judgement({}, [f"the shape did not become {last}"])
    formed = next(one.at for one in window(fleet.seen.leads, times.end - 1.0) if one.formed == last)
    settled = fleet.settles(30.0, since=formed)
    apart = fleet.seen.distances(judge.grid(times.begin, fleet.seen.now))
    wrong = [] if settled else [f"the formation did not settle as {last}"]
    return Judgement({"formed": max(0.0, formed - times.end), "nearest": float(apart.min())}, wrong)


ROW = Row("shapes", "hexagon → line → wedge", _change, verdict=_verdict, lasts=0.0)
