"""Whether an operator's request is for the mission that a process runs.

Robots of two missions may have the same names. What moves or releases robots is checked against the mission
that the operator has named, so only robots that run it obey. A stop and a hold are obeyed in any mission,
and sent without naming one, so that robots of an earlier version understand them.
"""

from __future__ import annotations

from collections.abc import Callable

from formation.control.laws import LAWS, UNUSABLE
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.request import OperatorReply, OperatorRequest, shortened
from formation.protocol.stops import RESTS


def tags_of(mission: Mission) -> frozenset[str]:
    """Return the tags by which a mission is known: by its file's law, or by the one that a run was given."""
    return frozenset(mission.under(kind).tag for kind in (*LAWS, *UNUSABLE))


class Addressee:
    """A process of one mission, as an operator's requests address it."""

    def __init__(self, mission: Mission) -> None:
        self._name, self._tag, self._tags = mission.name, mission.tag, tags_of(mission)

    def answer(
        self, request: OperatorRequest, obey: Callable[[], bytes], refuse: Callable[[], bytes]
    ) -> bytes:
        """Return ``obey()``; for another mission with a note, and ``refuse()`` if it would move robots.

        A request that states no mission is for any.
        """
        if not request.mission or request.mission in self._tags:
            return obey()
        rests = request.do == "query" or request.do in RESTS
        reply = json_message.decode(OperatorReply, obey() if rests else refuse())
        note = f"runs mission {self._name} ({self._tag}), not the one of this order ({request.mission})"
        reason = shortened("; ".join(filter(None, (note, reply.reason))))
        code = reply.code or "other-mission"
        return json_message.encode(reply.model_copy(update={"reason": reason, "code": code}))
