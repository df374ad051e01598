"""One driver's requests to the leader: velocities with the token of its newest reply. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.order import DRIVE_TIMEOUT_SECONDS
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.topics import ORDER
from formation.wire import BadMessage

PERIOD_SECONDS = 0.05
"""Time between two requests [s]."""
MAX_TOKEN_LAG = DRIVE_TIMEOUT_SECONDS * 1e3
"""By how much a token may be lower than an earlier one of the same process, as replies overtake each other
[ms]."""


class State(NamedTuple):
    """How the drive goes."""

    reply: OperatorReply | None = None
    """The leader's newest answer."""
    answered: float = float("-inf")
    """When it answered [s, monotonic]."""
    seconds: float = 0.0
    """Time from the request to the answer [s]."""

    @property
    def refusal(self) -> str:
        """Why the leader's newest answer refuses to be driven; empty if it does not."""
        reply = self.reply
        return "" if reply is None or reply.ok or reply.code == "first" else reply.reason

    def words(self, now: float) -> str:
        """Say in one line how the drive goes at `now` [s, monotonic]."""
        if self.reply is None or now - self.answered > DRIVE_TIMEOUT_SECONDS:
            return "no leader answers"
        if self.refusal:
            return f"{self.reply.robot} does not obey: {self.refusal}"
        return f"{self.reply.robot}: {self.reply.mode}, answers in {self.seconds * 1e3:.0f} ms"


class Remote:
    """A driver of one mission."""

    def __init__(self, mission: Mission, name: str) -> None:
        """`name` is unique for this run of the driver."""
        self.state = State()
        self._candidates, self._mission = mission.candidates, mission.tag
        self._name, self._token = name, 0

    def request(self, forward: float, turn_rate: float, now: float) -> tuple[tuple[str, ...], bytes]:
        """Return keys and payload of the next request, at `now` [s, monotonic]: forward [m/s; rad/s]."""
        reply, late = self.state.reply, now - self.state.answered > DRIVE_TIMEOUT_SECONDS
        receivers = self._candidates if reply is None or late else (reply.robot,)
        payload = json_message.encode(
            OperatorRequest(
                do="drive",
                forward=forward,
                turn_rate=turn_rate,
                token=self._token,
                id=self._name,
                mission=self._mission,
            )
        )
        return tuple(ORDER.key(name) for name in receivers), payload

    def process_replies(self, replies: Iterable[bytes], sent: float, now: float) -> None:
        """Take the replies at `now` to a request sent at `sent` [s, monotonic]; only the leader's counts."""
        for payload in replies:
            try:
                reply = json_message.decode(OperatorReply, payload)
            except BadMessage:
                continue
            if not reply.leads or reply.robot not in self._candidates:
                continue
            other = self.state.reply is None or reply.robot != self.state.reply.robot
            anew = self._token - reply.token > MAX_TOKEN_LAG  # of a leader that was restarted
            if reply.token:  # one of another mission gives none; with 0 this would be a driver that begins
                self._token = reply.token if other or anew else max(self._token, reply.token)
            self.state = State(reply, now, now - sent)
