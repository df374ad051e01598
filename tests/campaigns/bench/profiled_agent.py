"""`python -m formation.agent` with stopwatches at its interfaces; at its end it writes what they said.

python -m tests.campaigns.bench.profiled_agent FILE AGENT-ARGUMENTS…
"""

from __future__ import annotations

import gc
import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from formation.agent import __main__, core, inbox
from formation.agent.collision_filter import Avoiding
from formation.agent.following.neighbours import Neighbourhood
from formation.agent.pose.estimator import Localisation
from formation.agent.process import Sides
from formation.agent.safety import commander, failsafe
from formation.control import pipeline
from formation.control.controller import Controller
from formation.control.laws import law_of
from formation.protocol import json_message
from formation.topics import CMD_VEL, ODOM
from formation.transport.bus import Bus
from formation.wire import Now, Outgoing, Sample


class Profile:
    """What each step that was driven by odometry took, part by part [s]."""

    def __init__(self) -> None:
        self.steps: list[dict[str, float]] = []
        self.pauses: list[float] = []
        """Of the garbage collector [s]."""
        self._spent: dict[str, float] = defaultdict(float)
        self._collecting = 0.0

    def replace(self, owner: Any, name: str, label: str | Callable[..., str]) -> None:
        """Put the timed function in the place of `owner.name`."""
        setattr(owner, name, self.timed(getattr(owner, name), label))

    def timed(self, function: Callable[..., Any], label: str | Callable[..., str]) -> Callable[..., Any]:
        """The same function with a stopwatch; the label may depend on the arguments."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            start = time.monotonic()
            try:
                return function(*args, **kwargs)
            finally:
                self._spent[label if isinstance(label, str) else label(*args)] += time.monotonic() - start

        return timed

    def step(self, inner: Callable[[Sides, Now, Sequence[Sample]], Iterable[Outgoing]]) -> Callable[..., Any]:
        """`Sides.step`, recorded if odometry drives it."""

        def step(self_: Sides, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
            self._spent.clear()
            begin = time.monotonic()
            outbox = list(inner(self_, now, inbox))
            end = time.monotonic()
            received = [sample.arrived for sample in inbox if sample.key.endswith(ODOM.name)]
            if received:
                self.steps.append({"arrived": received[-1], "begin": begin, "end": end, **self._spent})
            return outbox

        return step

    def collected(self, phase: str, _info: dict[str, int]) -> None:
        """A hook for the garbage collector."""
        if phase == "start":
            self._collecting = time.monotonic()
        else:
            self.pauses.append(time.monotonic() - self._collecting)


def install(profile: Profile) -> None:
    """Put the stopwatches in."""
    profile.replace(inbox, "decode", "decode")
    profile.replace(json_message, "decode", "decode")
    for module in (core, commander):
        profile.replace(module, "encode", lambda message: f"encode {type(message).__name__}")
    profile.replace(json_message, "encode", "encode Order")
    profile.replace(failsafe, "decide", "failsafe")
    profile.replace(Neighbourhood, "measured", "law")
    profile.replace(Localisation, "update_pose", "observer")
    profile.replace(Avoiding, "obstacles", "collision filter")
    profile.replace(pipeline, "avoid", "collision filter")
    profile.replace(pipeline, "brake", "collision filter")

    def timed_law_of(name: str) -> Controller:
        law = law_of(name)
        return law._replace(step=profile.timed(law.step, "law"))

    setattr(core, law_of.__name__, timed_law_of)
    setattr(Sides, Sides.step.__name__, profile.step(Sides.step))
    publish = Bus.publish

    def published(bus: Bus, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        start = time.monotonic()
        publish(bus, key, payload, attachment)
        if profile.steps and key.endswith(CMD_VEL.name) and "sent" not in profile.steps[-1]:
            profile.steps[-1].update(sending=start, sent=time.monotonic())

    setattr(Bus, publish.__name__, published)
    gc.callbacks.append(profile.collected)


if __name__ == "__main__":
    whole = Profile()
    install(whole)
    code = __main__.main(sys.argv[2:])
    Path(sys.argv[1]).write_text(json.dumps({"steps": whole.steps, "pauses": whole.pauses}))
    sys.exit(code)
