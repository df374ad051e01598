"""The candidates: the leader's own process and the standbys, each with its status."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from formation.mission.model import Mission
from formation.monitor.metrics.feed import Feed
from formation.monitor.metrics.keys import Watched
from formation.monitor.metrics.requests import Requests
from formation.monitor.metrics.snapshot import CandidateMetrics
from formation.monitor.metrics.statuses import Handler, Statuses
from formation.protocol import order
from formation.protocol.election import check_ballot
from formation.protocol.order import Ballot
from formation.protocol.status import LeaderStatus
from formation.ros2.messages import Text, decode
from formation.topics import BALLOT, STATUS
from formation.wire import Now, Sample

LEADS = "leads"


class Candidates:
    """All candidates, by rank; empty if there are no standbys."""

    def __init__(
        self, mission: Mission, keys: Mapping[str, list[Watched]], own: Statuses, requests: Requests
    ) -> None:
        """`keys` are by name; `own` has the statuses of the leader's own process."""
        self._mission = mission
        self._statuses: dict[str, Statuses] = {mission.leader: own} if mission.standbys else {}
        self._feeds: dict[str, tuple[Watched, Feed]] = {}
        for name in mission.standbys:
            for one in keys[name]:
                self._feeds[one.key] = one, Feed(one.rate)
            status = self._feeds[STATUS.key(name)][1]
            self._statuses[name] = Statuses(LeaderStatus, status, partial(requests.add_from_status, name))

    def routes(self) -> Iterator[tuple[str, Feed, Handler | None]]:
        """Yield key, feed and handler of every key of the standbys."""
        for key, (one, feed) in self._feeds.items():
            handlers: dict[str, Handler] = {
                STATUS.name: self._statuses[one.robot].process_status,
                BALLOT.name: ballots_of(self._mission, one.robot),
            }
            yield key, feed, handlers.get(one.topic.name)

    def clock_was_set(self) -> None:
        """Forget clocks after our system clock was set."""
        for _, feed in self._feeds.values():
            feed.forget_clock()

    def state(self, name: str, now: Now) -> tuple[str, str] | None:
        """Return state and reason of candidate `name` by its status; None if there are none."""
        statuses = self._statuses.get(name)
        return None if statuses is None else statuses.state(now)

    def newest(self, name: str, now: Now) -> LeaderStatus | None:
        """Return the candidate's newest status; None if it is not fresh."""
        statuses = self._statuses.get(name)
        newest_status = None if statuses is None else statuses.newest(now)
        return newest_status if isinstance(newest_status, LeaderStatus) else None

    def metrics(self, now: Now, leads: str | None) -> Mapping[str, CandidateMetrics]:
        """Return the metrics of all candidates; `leads` leads."""
        return {name: _metrics(one, now, leads=name == leads) for name, one in self._statuses.items()}


def ballots_of(mission: Mission, candidate: str) -> Handler:
    """Return the check of `candidate`'s ballots; the voting robots act on them."""

    def check(sample: Sample, wall: float) -> None:
        ballot = order.decode(Ballot, decode(Text, sample.payload).text.encode())
        check_ballot(ballot, candidate, mission, Now(sample.arrived, wall))

    return check


def _metrics(statuses: Statuses, now: Now, *, leads: bool) -> CandidateMetrics:
    state, reason = statuses.state(now)
    silence = statuses.feed.silence(now.mono)
    age = silence if silence < float("inf") else None
    return CandidateMetrics(LEADS if leads else state, reason, age)
