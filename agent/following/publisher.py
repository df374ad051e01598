"""Which process publishes for a neighbour, and whether its message is new.

A second agent run for a robot by mistake, and a replayed recording, both publish well-formed positions on the
right key. A neighbour is therefore bound to the first publisher id received, and each id to its own count.
Another id is refused until the first has been silent for longer than it would be followed; repeated messages
are always refused. An earlier id is accepted again when its successor is silent: otherwise an agent that was
cut off while a second one ran would be refused for ever. Only a leader of a later term, for which this robot
has voted, need not wait.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from formation.control.tracker import FRESH_PERIODS
from formation.protocol.attachment import PositionAttachment
from formation.wire import BadMessage

MAX_COUNT_LEAP = 1.0
"""Rise of a count that is allowed between two messages, in addition to the time between them [s]."""
MAX_SILENT_IDS = 64
"""Number of silent publisher ids of which the newest count is kept, to refuse repeated messages."""


def rises(count: int, before: int, wait: float, rate: float) -> bool:
    """Whether a living process that counts at `rate` [Hz] can have counted so far in `wait` [s]."""
    return 0 < count - before <= 2.0 * rate * (MAX_COUNT_LEAP + max(0.0, wait))


@dataclass(slots=True, kw_only=True)
class AcceptedPublisherState:
    """The accepted publisher id, and former ones."""

    contested: float = float("-inf")
    """When another id was last refused [s, monotonic]."""
    bound: PositionAttachment | None = None
    """The newest accepted message."""
    received: float = float("-inf")
    """When that was received [s, monotonic]."""
    leapt: tuple[int, float] | None = None
    """A count that rose too far in a silence, and when that was received [s, monotonic]."""
    former: dict[str, int] = field(default_factory=dict)
    """The newest count of each former id."""


class AcceptedPublisher:
    """The publisher id that is accepted for a neighbour."""

    def __init__(self, name: str, rate: float) -> None:
        """`rate` [Hz] is how often `name` publishes its position."""
        self.limit = FRESH_PERIODS / rate
        """Silence after which another id is accepted for it [s]."""
        self.state = AcceptedPublisherState()
        self._name, self._rate = name, rate

    def admit(self, attachment: PositionAttachment, arrived: float, voted_term: int = 0) -> None:
        """Accept the message, or raise BadMessage. `voted_term`: 0 if there is none."""
        state = self.state
        if state.bound is not None:
            self._judge(attachment, state.bound, arrived - state.received, arrived, voted_term)
        state.bound, state.received, state.leapt = attachment, arrived, None

    def _judge(
        self,
        attachment: PositionAttachment,
        bound: PositionAttachment,
        wait: float,
        arrived: float,
        voted_term: int,
    ) -> None:
        state = self.state
        if attachment.publisher_id == bound.publisher_id:
            if attachment.count <= bound.count:
                raise BadMessage(
                    f"repeated or late: position {attachment.count}; this publisher is at {bound.count}"
                )
            if not rises(attachment.count, bound.count, wait, self._rate) and not self._goes_on(
                attachment, wait, arrived
            ):
                raise BadMessage(f"position count leaps from {bound.count} to {attachment.count}")
            return
        if attachment.count <= state.former.get(attachment.publisher_id, -1):
            raise BadMessage(f"repeated: position {attachment.count} of a former publisher of {self._name}")
        if wait <= self.limit and not 0 < _term(bound) < _term(attachment) == voted_term:
            state.contested = arrived
            raise BadMessage(f"{self._name} has a second publisher")
        state.former.pop(attachment.publisher_id, None)
        state.former[bound.publisher_id] = bound.count
        if len(state.former) > MAX_SILENT_IDS:
            state.former.pop(next(iter(state.former)))

    def _goes_on(self, attachment: PositionAttachment, wait: float, arrived: float) -> bool:
        """Whether a second message confirms a leap after a silence by following from the first.

        Without that a robot that publishes more than twice as often as its mission says would be refused for
        ever after an outage, because its count then rises faster than allowed.
        """
        leapt, self.state.leapt = self.state.leapt, (attachment.count, arrived)
        if leapt is None or wait <= self.limit:
            return False
        return rises(attachment.count, leapt[0], arrived - leapt[1], self._rate)


def _term(attachment: PositionAttachment) -> int:
    return attachment.order.term if attachment.order is not None else attachment.term
