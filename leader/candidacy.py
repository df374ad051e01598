"""One candidate's state in the election: whether it leads, and the ballots that it sends.

`formation.protocol.election` explains why no two candidates lead at once.
"""

from __future__ import annotations

from typing import NamedTuple

from formation.mission.model import Mission
from formation.protocol.attachment import Ballot, PositionAttachment, Refusal, check_mission
from formation.protocol.election import (
    CAMPAIGN_TIME,
    LEADERLESS_TIME,
    LEASE_TIME,
    LISTENING_TIME,
    RANK_WAIT,
    READING_TIME,
    RENEWAL_PERIOD,
    REPORT_TIME,
    VOTE_BOUND_TIME,
    CandidacyState,
    check_ballot,
    check_term,
    new_term,
    quarantine,
    set_forward,
    too_far,
)
from formation.protocol.lateness import MAX_BEAT_LATENESS, Count, counted
from formation.protocol.order import LEADER_TIMEOUT_SECONDS, Order
from formation.wire import BadMessage, Now


class Publisher(NamedTuple):
    """The process that sends a robot's positions."""

    id: str
    number: int
    """The number of its newest position."""
    since: float
    """Arrival of its first message, or of its first after another publisher's [s, monotonic]."""


class Candidacy:
    """One candidate's state. Each step: `receive` what has arrived, then `step`, and only then send."""

    def __init__(self, mission: Mission, name: str, known: int = 0) -> None:
        """`known`: the newest term that the previous process knew. ValueError if `name` is no candidate."""
        if name not in mission.candidates:
            legal = ", ".join(mission.candidates)
            raise ValueError(f"candidate {name!r}: must be one of {legal}")
        self.state: CandidacyState = "listening"
        self.term = 0
        """The newest term for which it was a candidate; 0 before the first."""
        self.known = known
        """The highest known term."""
        self._publishers: dict[str, Publisher] = {}  # of each robot's positions
        self._refusals: dict[str, tuple[int, Refusal, float]] = {}  # which term each robot refuses, and when
        self._mission, self._rank = mission, mission.candidates.index(name)
        self._needs_votes = bool(mission.standbys)
        self._majority = len(mission.followers) // 2 + 1
        self._awaited = linked(mission)
        self._quarantine = quarantine(mission)
        self._period = RENEWAL_PERIOD * min(1.0, mission.takeover)
        self._started_at: float | None = None
        self._first_received: float | None = None  # arrival of the first position
        self._read_term = 0  # newest term of the relayed orders that it could read
        self._relayed_term = 0  # newest term of all relayed orders
        self._term_seen = False  # whether any term was received: if not, the fleet is just being started
        self._waits_until = float("inf")  # a standby waits at least until then [s, monotonic]
        self._last_sign = float("-inf")  # when there was last a sign of a leader or another candidate
        self._given_up_term = 0  # the newest term that was given up: votes for it are no such sign
        self._wait_rank = self._rank  # a standby waits this many times `RANK_WAIT` longer
        self._received: dict[str, float] = {}  # arrival of each robot's newest position
        self._last_ballots: dict[str, tuple[int, int]] = {}  # its voted term and last ballot
        self._relays: dict[str, tuple[int, int]] = {}  # term and beat that each robot relays
        self._beat = 0, 0  # the newest that has risen at one of them
        self._later_rose = False  # whether a beat of a later term than its own has risen
        self._beats: Count | None = None
        self._beat_period = 1.0 / mission.robots[mission.leader].rate
        self._outbid: float | None = None  # since when a robot is known to have voted for a later term
        self._sent: dict[int, float] = {}  # when each ballot of this term was sent; those that still count
        self._voted_at: dict[str, float] = {}  # when the ballot for which each robot voted last was sent
        self._ballot_number = 0
        self._next_ballot_at = self._candidate_since = 0.0
        self._drawn_at: Now | None = None  # when it drew its term, by both clocks

    @property
    def leading(self) -> bool:
        """Whether it led in its newest step, and may send orders in it."""
        return self.state == "leader"

    @property
    def lease_end(self) -> float:
        """Until when it may lead without another step [s, monotonic]; -inf if it does not lead."""
        if not self.leading:
            return float("-inf")
        return self._lease if self._needs_votes else float("inf")

    @property
    def due(self) -> float:
        """When the next step is due if nothing arrives [s, monotonic]."""
        if self._started_at is None:
            return float("-inf")
        if self.state == "listening":
            return self._listens_until
        if not self._needs_votes:
            return float("inf") if self.leading else self._last_sign + LEADER_TIMEOUT_SECONDS
        if self.state == "standby":
            return self._candidate_at
        return min(self._next_ballot_at, self._ends_at)

    @property
    def has_received(self) -> bool:
        """Whether it has received a position of any robot, of this mission or another."""
        return self._first_received is not None

    @property
    def unread(self) -> bool:
        """Whether robots relay an order that is newer than all that it could read."""
        return self._relayed_term > self._read_term

    def receive(self, robot: str, attachment: PositionAttachment, arrived: float, now: Now) -> None:
        """Take in what came with a follower's position.

        An agent that does not command the robot has no vote, and is another publisher than the one that does.

        Raises BadMessage for an absurd term, another mission, and a repeated message.
        """
        self._first_received = arrived if self._first_received is None else self._first_received
        check_mission(robot, attachment.mission, self._mission.tag)
        order_term = attachment.order.term if attachment.order else attachment.term
        check_term(max(attachment.voted_term, order_term), now)
        sender = f"{robot} readonly" if attachment.readonly else robot
        counts = self._votes_count(sender, attachment, arrived) and not attachment.readonly
        if attachment.because is not None:
            self._refusals[robot] = attachment.refused, attachment.because, arrived
            earlier = attachment.refused == self.term and attachment.because == "earlier"
            if earlier and (not self._needs_votes or self.known > self.term):
                self._outbid = arrived if self._outbid is None else self._outbid
        if self._needs_votes and counts:
            self._count_vote(robot, attachment, arrived)
        if attachment.order is not None:
            self._note_relayed_order(sender, attachment.order, arrived)
            self._read_term = max(self._read_term, attachment.order.term)
        self._relayed_term = max(self._relayed_term, attachment.term)
        self.known = max(self.known, attachment.voted_term, attachment.term)
        self._term_seen = self._term_seen or bool(attachment.voted_term or attachment.order)
        if not attachment.readonly:
            self._received[robot] = arrived

    def receive_ballot(self, ballot: Ballot, other: str, arrived: float, now: Now) -> None:
        """Take in another candidate's ballot. Raises BadMessage if it is no valid ballot of `other`."""
        check_ballot(ballot, other, self._mission, now)
        if ballot.candidacy != "leaving":
            self._last_sign = max(self._last_sign, arrived)
        elif ballot.term >= self.known:  # the lead is vacant, and all robots may vote
            self._last_sign, self._given_up_term = arrived - self._in_takeovers(LEADERLESS_TIME), ballot.term
        self.known, self._term_seen = max(self.known, ballot.term), True

    def step(self, now: Now) -> Ballot | None:
        """Update the candidacy; return the ballot to publish now, if any."""
        if self._started_at is None:
            self._started_at = self._last_sign = now.mono
        self._listen(now)
        if not self._needs_votes:
            self._lead_alone(now)
            return None
        if self.leading and now.mono >= self._ends_at:
            self._stand_by(self._rank)
        elif self.leading and (
            (self._outbid is not None and self._passed(self._outbid, LEADERLESS_TIME, now))
            or (too_far(self.term, now) and "ahead" in self.refusals(now.mono).values())
        ):
            # to become a candidate again at once
            self._last_sign, self._wait_rank = now.mono - self._in_takeovers(LEADERLESS_TIME), 0
            return self.leave(now)
        elif self.state == "candidate":
            self._campaign(now)
        elif self.state == "standby" and now.mono >= self._candidate_at:
            self._try_candidacy(now)
        if self.state not in {"candidate", "leader"} or now.mono < self._next_ballot_at:
            return None
        self._next_ballot_at = now.mono + self._period
        return self._ballot(now)

    def leave(self, now: Now) -> Ballot | None:
        """Give up the candidacy or the lead; return the ballot that says so."""
        if self.state not in {"candidate", "leader"}:
            return None
        self.state, self._given_up_term = "standby", self.term
        return self._ballot(now) if self._needs_votes else None

    def refusals(self, mono: float) -> dict[str, Refusal]:
        """Return the robots that lately refused its term, with their reasons; `mono` in s, monotonic."""
        return {
            robot: because
            for robot, (term, because, when) in self._refusals.items()
            if term == self.term and mono - when <= REPORT_TIME
        }

    def _votes_count(self, robot: str, attachment: PositionAttachment, arrived: float) -> bool:
        """Note the publisher; return whether its votes count, as they do not just after a change of it."""
        known = self._publishers.get(robot)
        if known is None or known.id != attachment.publisher_id:
            known = Publisher(attachment.publisher_id, attachment.count, arrived)
            self._voted_at.pop(robot, None)
            self._last_ballots.pop(robot, None)
            self._relays.pop(robot, None)
        elif attachment.count <= known.number:
            raise BadMessage(
                f"repeated or late: position {attachment.count} of {robot}, which is at {known.number}"
            )
        self._publishers[robot] = known._replace(number=attachment.count)
        return arrived - known.since >= self._in_takeovers(VOTE_BOUND_TIME)

    def _count_vote(self, robot: str, attachment: PositionAttachment, arrived: float) -> None:
        seen, before = (attachment.voted_term, attachment.last_ballot), self._last_ballots.get(robot)
        # the first report proves nothing: a robot repeats the last ballot of a leader that died
        risen = before is not None and (
            attachment.voted_term != before[0] or attachment.last_ballot > before[1]
        )
        if before is None or seen != before:
            self._last_ballots[robot] = seen
            if risen and attachment.voted_term not in {0, self._given_up_term}:
                self._last_sign = max(self._last_sign, arrived)
                self._wait_rank = self._wait_rank if attachment.voted_term == self.term else self._rank
        sent = self._sent.get(attachment.last_ballot) if attachment.voted_term == self.term else None
        if sent is not None:
            self._voted_at[robot] = max(sent, self._voted_at.get(robot, sent))
        if attachment.voted_term > self.term and self._outbid is None:
            self._outbid = arrived

    def _note_relayed_order(self, robot: str, order: Order, arrived: float) -> None:
        """Take in a relayed order: a rising beat that is not its own shows another leader."""
        self.known = max(self.known, order.term)
        beat, before = (order.term, order.beat), self._relays.get(robot)
        self._relays[robot] = beat
        if before in {None, beat} or order.term == self._given_up_term:
            return  # the first beat proves nothing: robots still relay the order of a leader that died
        if order.term == self._beat[0] and beat <= self._beat:
            return  # already known from a robot nearer to that leader
        if not self._in_time(order, arrived):
            return
        self._beat = beat
        if not (self.leading and order.term == self.term):
            self._last_sign = max(self._last_sign, arrived)
        self._later_rose = self._later_rose or order.term > self.term

    def _in_time(self, order: Order, arrived: float) -> bool:
        """Return whether a beat is hardly later than the fastest of its term; else its leader may be dead."""
        if self._beats is not None and order.term < self._beats.term:
            return True
        stamp = order.beat * self._beat_period
        self._beats, late = counted(self._beats, order.term, stamp, arrived, MAX_BEAT_LATENESS)
        return late <= MAX_BEAT_LATENESS

    def _listen(self, now: Now) -> None:
        if self.state == "listening" and now.mono >= self._listens_until:
            self.state, self._waits_until = "standby", now.mono

    @property
    def _listens_until(self) -> float:
        """Until when it listens if nothing more arrives [s, monotonic].

        Without standbys it listens until it has received a robot. Otherwise, where robots receive it and it
        receives none, it would replace the relayed order, with its stop and its place, by the route's start.
        """
        since = (
            self._first_received
            if self._first_received is not None or not self._needs_votes
            else self._started_at
        )
        if since is None:
            return float("inf")
        if self.unread:
            return since + READING_TIME
        return float("-inf") if self._awaited <= self._received.keys() else since + LISTENING_TIME

    def _lead_alone(self, now: Now) -> None:
        """Lead without votes, unless a leader of a later term is alive."""
        if self.leading and (self._later_rose or self._outbid is not None):
            self.state, self._last_sign = "standby", now.mono
        first = self.state == "standby" and self.term == 0
        silent = self.state == "standby" and now.mono - self._last_sign > LEADER_TIMEOUT_SECONDS
        if first or silent or (self.leading and self._clock_set(now)):
            self._given_up_term, self.state, self._drawn_at = self.term, "leader", now
            self.term = self.known = new_term(self._rank, now, self.known)
            self._outbid, self._later_rose = None, False

    def _clock_set(self, now: Now) -> bool:
        """Return whether its clock was set after it drew its term: robots may refuse that as earlier."""
        return too_far(self.term, now) or (self._drawn_at is not None and set_forward(self._drawn_at, now))

    def _campaign(self, now: Now) -> None:
        if now.mono < self._lease:
            self.state, self._wait_rank = "leader", self._rank
        elif self.known > self.term and not too_far(self.known, now):  # `new_term` ignores those as well
            self._stand_by(self._rank)
        elif self._passed(self._candidate_since, CAMPAIGN_TIME, now):  # another may reach more robots
            self._last_sign = now.mono  # others have received this candidacy until now; they wait less long
            self._stand_by(self._rank + len(self._mission.candidates))

    def _try_candidacy(self, now: Now) -> None:
        """Become a candidate if over half of the followers are received and may vote by now."""
        lately = [
            robot
            for robot, arrived in self._received.items()
            if not self._passed(arrived, LEADERLESS_TIME, now)
        ]
        ages = [now.mono - self._publishers[robot].since for robot in lately]
        if sum(age >= self._quarantine for age in ages) < self._majority:
            # to try again soon
            self._waits_until = now.mono + self._in_takeovers(RANK_WAIT * (1 - self._wait_rank))
            return
        self._become_candidate(now)

    def _become_candidate(self, now: Now) -> None:
        self.state, self.term = "candidate", new_term(self._rank, now, self.known)
        self._candidate_since = self._next_ballot_at = now.mono
        self.known, self._outbid = self.term, None
        self._sent.clear()
        self._voted_at.clear()

    def _stand_by(self, wait_rank: int) -> None:
        self.state, self._wait_rank = "standby", wait_rank

    def _ballot(self, now: Now) -> Ballot:
        """Return the next ballot. Numbers derive from the clock, so that a restarted process repeats none."""
        self._ballot_number = max(self._ballot_number + 1, int(now.mono * 1e6))
        counting = now.mono - self._in_takeovers(LEASE_TIME)
        self._sent = {number: sent for number, sent in self._sent.items() if sent > counting}
        self._sent[self._ballot_number] = now.mono
        candidacy = self.state if self.state in {"candidate", "leader"} else "leaving"
        return Ballot(
            term=self.term, number=self._ballot_number, candidacy=candidacy, mission=self._mission.tag
        )

    @property
    def _lease(self) -> float:
        """Until when the votes of more than half of the followers count [s, monotonic]."""
        if len(self._voted_at) < self._majority:
            return float("-inf")
        newest = sorted(self._voted_at.values(), reverse=True)
        return newest[self._majority - 1] + self._in_takeovers(LEASE_TIME)

    @property
    def _ends_at(self) -> float:
        """When its candidacy or lead ends if no more votes arrive [s, monotonic]."""
        return self._lease if self.leading else self._candidate_since + self._in_takeovers(CAMPAIGN_TIME)

    @property
    def _candidate_at(self) -> float:
        """When a standby becomes a candidate if nothing else happens [s, monotonic]."""
        quiet = max(self._last_sign + self._in_takeovers(LEADERLESS_TIME), self._waits_until)
        if not self._term_seen and self._rank:
            # a fleet that has just been started is left to the mission's leader, if that one runs
            quiet += LISTENING_TIME + self._quarantine
        return quiet + self._in_takeovers(RANK_WAIT * self._wait_rank)

    def _in_takeovers(self, share: float) -> float:
        return share * self._mission.takeover

    def _passed(self, since: float, share: float, now: Now) -> bool:
        return now.mono - since >= self._in_takeovers(share)


def linked(mission: Mission) -> frozenset[str]:
    """Return the followers that a candidate receives: all with standbys, else those that may measure it."""
    return frozenset(
        name
        for name in mission.followers
        if mission.standbys or mission.leader in mission.robots[name].measurable
    )
