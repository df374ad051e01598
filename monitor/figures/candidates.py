"""Who may lead: the leader's own process and the standbys, each with what it says of itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from formation import order
from formation.election import check_ballot
from formation.mission import Mission
from formation.order import Ballot
from formation.ros2.messages import Text, decode
from formation.topics import BALLOT, STATUS
from formation.wire import Now, Sample
from monitor.figures.asked import Requests
from monitor.figures.feed import Feed
from monitor.figures.keys import Watched
from monitor.figures.snapshot import CandidateFigures
from monitor.figures.statuses import Handler, Statuses

LEADS = "leads"


class Candidates:
    """Everybody who may lead, by rank; nobody where there is nothing to agree on."""

    def __init__(
        self, mission: Mission, keys: Mapping[str, list[Watched]], own: Statuses, requests: Requests
    ) -> None:
        """`keys` are by name; `own` has what the leader's own process says of itself."""
        self._mission = mission
        self._statuses: dict[str, Statuses] = {mission.leader: own} if mission.standbys else {}
        self._feeds: dict[str, tuple[Watched, Feed]] = {}
        for name in mission.standbys:
            for one in keys[name]:
                self._feeds[one.key] = one, Feed(one.rate)
            status = self._feeds[STATUS.key(name)][1]
            self._statuses[name] = Statuses(status, partial(requests.take, name))

    def routes(self) -> Iterator[tuple[str, Feed, Handler | None]]:
        """Key, feed and handler of everything that standbys say."""
        for key, (one, feed) in self._feeds.items():
            handlers: dict[str, Handler] = {
                STATUS.name: self._statuses[one.robot].take,
                BALLOT.name: ballots_of(self._mission, one.robot),
            }
            yield key, feed, handlers.get(one.topic.name)

    def clock_was_set(self) -> None:
        """Our system clock was."""
        for _, feed in self._feeds.values():
            feed.forget_clock()

    def state(self, name: str, now: Now) -> tuple[str, str] | None:
        """State and reason of candidate `name`, by its own words; None for none."""
        statuses = self._statuses.get(name)
        return None if statuses is None else statuses.state(now)

    def values(self, name: str, now: Now) -> Mapping[str, str]:
        """All that it says of itself."""
        statuses = self._statuses.get(name)
        return {} if statuses is None else statuses.values(now)

    def figures(self, now: Now, leads: str | None) -> Mapping[str, CandidateFigures]:
        """How everybody is; `leads` leads."""
        return {name: _figures(one, now, leads=name == leads) for name, one in self._statuses.items()}


def ballots_of(mission: Mission, candidate: str) -> Handler:
    """What checks the ballots of `candidate`; they are followed by those who vote."""

    def check(sample: Sample, wall: float) -> None:
        ballot = order.decode(Ballot, decode(Text, sample.payload).text.encode())
        check_ballot(ballot, candidate, mission, Now(sample.arrived, wall))

    return check


def _figures(statuses: Statuses, now: Now, *, leads: bool) -> CandidateFigures:
    state, reason = statuses.state(now)
    silence = statuses.feed.silence(now.mono)
    age = silence if silence < float("inf") else None
    return CandidateFigures(LEADS if leads else state, reason, age)
