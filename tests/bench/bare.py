"""The yardstick: Zenoh and nothing else. Not one import of this project; the plan comes as JSON.

python tests/bench/bare.py PLAN

Hears the plan's keys and, straight in the callback, answers each message on `answer_to` with the payloads
that the plan has for it; beside that it sends others every `period` seconds. With one key to hear and one
answer it is an echo.
"""

from __future__ import annotations

import json
import os
import sys
import time
from typing import Any

import zenoh

PRIORITY = {
    "real_time": zenoh.Priority.REAL_TIME,
    "data": zenoh.Priority.DATA,
    "background": zenoh.Priority.BACKGROUND,
}


def main(plan: dict[str, Any]) -> None:
    """Do what the plan says until the parent is gone."""
    parent = os.getppid()
    with zenoh.open(zenoh.Config.from_json5(json.dumps(plan["config"]))) as session:

        def out(row: dict[str, Any]) -> tuple[zenoh.Publisher, bytes, bytes | None]:
            publisher = session.declare_publisher(
                row["key"],
                congestion_control=zenoh.CongestionControl.DROP,
                priority=PRIORITY[row["priority"]],
                express=row["express"],
            )
            return publisher, bytes.fromhex(row["payload"]), bytes.fromhex(row["attachment"]) or None

        answers = [out(row) for row in plan["answers"]]
        beside = [out(row) for row in plan["beside"]]

        def answer(_sample: zenoh.Sample) -> None:
            for publisher, payload, attachment in answers:
                publisher.put(payload, attachment=attachment)

        def ignore(_sample: zenoh.Sample) -> None:
            pass

        session.declare_subscriber(plan["answer_to"], zenoh.handlers.Callback(answer, indirect=False))
        for key in plan["hears"]:
            session.declare_subscriber(key, zenoh.handlers.Callback(ignore, indirect=False))
        while os.getppid() == parent:
            for publisher, payload, attachment in beside:
                publisher.put(payload, attachment=attachment)
            time.sleep(plan["period"])


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
