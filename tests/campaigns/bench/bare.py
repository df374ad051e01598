"""The yardstick: Zenoh and nothing else. Not one import of this project; the plan comes as JSON.

python tests/campaigns/bench/bare.py PLAN

Hears the plan's keys and, straight in the callback, answers each message on `answer_to` with the payloads
that the plan has for it, and repeats the message itself; beside that it sends others every `period` seconds.
It has a session for each side of the plan: the robot's and, unless it is a mere echo, the fleet's.
"""

from __future__ import annotations

import json
import os
import sys
import time
from contextlib import ExitStack
from typing import Any

import zenoh


def main(plan: dict[str, Any]) -> None:
    """Do what the plan says until the parent is gone."""
    parent = os.getppid()
    with ExitStack() as stack:
        sides = {
            side: stack.enter_context(zenoh.open(zenoh.Config.from_json5(json.dumps(config))))
            for side, config in plan["sides"].items()
        }

        def out(row: dict[str, Any]) -> tuple[zenoh.Publisher, bytes, bytes | None]:
            publisher = sides[row["side"]].declare_publisher(
                row["key"],
                congestion_control=zenoh.CongestionControl.DROP,
                priority=getattr(zenoh.Priority, row["priority"].upper()),
                express=row["express"],
            )
            return publisher, bytes.fromhex(row["payload"]), bytes.fromhex(row["attachment"]) or None

        answers = [out(row) for row in plan["answers"]]
        repeats = [out(row)[0] for row in plan["repeats"]]
        beside = [out(row) for row in plan["beside"]]

        def answer(sample: zenoh.Sample) -> None:
            for publisher, payload, attachment in answers:
                publisher.put(payload, attachment=attachment)
            for publisher in repeats:
                publisher.put(sample.payload)

        def ignore(_sample: zenoh.Sample) -> None:
            pass

        sides["robot"].declare_subscriber(plan["answer_to"], zenoh.handlers.Callback(answer, indirect=False))
        for key in plan["hears"]:
            sides["fleet"].declare_subscriber(key, zenoh.handlers.Callback(ignore, indirect=False))
        while os.getppid() == parent:
            for publisher, payload, attachment in beside:
                publisher.put(payload, attachment=attachment)
            time.sleep(plan["period"])


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
