"""What signed orders cost a robot: beside a step, and in the time from odometry to the command.

python -m tests.campaigns.bench.bench_signing [--rounds N] [--json]

A follower with two neighbours that relay the same beats, signed and not, in turns. Orders are verified when
they arrive, on the receive thread; "verify, in the step" says what a step would take if that were done there.
Medians.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from formation.agent.core import Agent
from formation.deploy.fleet import authority
from formation.mission.file import parse
from formation.protocol import json_message, order
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.protocol.status import AgentState
from formation.ros2.messages import encode
from formation.topics import ODOM, POSITION
from formation.transport.security.signing import Authority, Signer, key_id_of
from formation.transport.security.verifying import Verifier
from formation.transport.session import Identity
from formation.wire import Now, Sample
from tests.campaigns.bench import edge
from tests.campaigns.figures import command, markdown, over_rounds, span

STEPS = 1500
MISSION = parse(edge.mission(rate=20.0))
PERIOD = 0.05
"""[s]"""


def keys(folder: Path) -> tuple[Signer, Verifier]:
    """The leader's, and what a follower verifies with."""
    now = datetime.now(UTC)
    team = authority.new_authority("team", 1.0, now)
    pair = authority.issue(team, edge.LEADER, None, 1.0, now)
    files = [folder / name for name in ("ca.pem", "key.pem", "certificate.pem")]
    for file, content in zip(files, (team.certificate_pem, pair.key_pem, pair.certificate_pem), strict=True):
        file.write_bytes(content)
    signer = Signer(Identity(*files), edge.LEADER, now.timestamp())
    return signer, Verifier(MISSION, Authority(files[0]).read, key_id_of, signer.certificate)


def microseconds(call: Callable[[], object], times: int = 400) -> float:
    """Median time of one call [µs]: other processes of the machine do not count."""
    took = []
    for _ in range(times):
        start = time.perf_counter()
        call()
        took.append(time.perf_counter() - start)
    return 1e6 * statistics.median(took)


class Follower:
    """One agent, and what comes to it in a period."""

    def __init__(self, signer: Signer | None, verifier: Verifier) -> None:
        self.agent, self.signer, self.verifier = Agent(MISSION, edge.FOLLOWER), signer, verifier
        self.steps: list[float] = []
        """From the inbox to the command [µs]."""
        self._began = time.time()
        self._robot = edge.Follower()
        self.checks: list[float] = []
        """Of verifying both neighbours' orders of a period [µs]."""

    def turn(self, beat: int) -> None:
        """A period: two positions, then odometry."""
        elapsed = beat * PERIOD
        now = Now(elapsed, self._began + elapsed)
        attachment = self._told(beat)
        inbox = []
        for robot in (edge.LEADER, edge.NEIGHBOUR):
            payload = encode(edge.position(robot, elapsed, now.wall))
            carried = json_message.encode(attachment.model_copy(update={"publisher_id": robot}))
            inbox.append(Sample(POSITION.key(robot), payload, carried, now.mono))
        start = time.perf_counter()
        if self.signer is not None:
            inbox = [self.verifier.check(sample, now.wall) for sample in inbox]
        self.checks.append(1e6 * (time.perf_counter() - start))
        payload = encode(self._robot.odometry(self.agent.command, PERIOD, now.wall))
        inbox.append(Sample(ODOM.key(edge.FOLLOWER), payload, None, now.mono))
        start = time.perf_counter()
        self.agent.act(now, inbox)
        self.steps.append(1e6 * (time.perf_counter() - start))
        self.agent.tell(now)

    def _told(self, beat: int) -> PositionAttachment:
        what = Order(term=64, beat=beat, mode="run", shape="line", time=beat * PERIOD)
        carried: dict[str, Any] = {"order": what}
        if self.signer is not None:
            text = json_message.encode(what).decode()
            statement = order.statement(MISSION.fingerprint, text)
            carried = {"signed": text, "signature": self.signer.sign(statement)}
        return PositionAttachment(publisher_id="bench", count=beat, mission=MISSION.tag, **carried)


def periods(signer: Signer, verifier: Verifier) -> dict[str, float]:
    """Medians of a period, signed and not, in turns [µs]."""
    plain, signed = Follower(None, verifier), Follower(signer, verifier)
    for beat in range(1, STEPS):
        for one in (plain, signed):
            one.turn(beat)
    for one in (plain, signed):
        assert one.agent.decision.state is AgentState.RUN, one.agent.decision
        assert not one.agent.dropped, one.agent.dropped
    before, after = statistics.median(plain.steps), statistics.median(signed.steps)
    checks = statistics.median(signed.checks)
    return {
        "odometry → command, not signed": before,
        "odometry → command, signed": after,
        "slower by [%]": 100.0 * (after / before - 1.0),
        "on the receive thread, per period": checks,
        "verify, in the step: slower by [%]": 100.0 * ((after + checks) / before - 1.0),
    }


def primitives(signer: Signer, verifier: Verifier) -> dict[str, float]:
    """Of one message [µs]."""
    what = Order(term=64, beat=1, mode="run", shape="line")
    text = json_message.encode(what).decode()
    message = order.statement(MISSION.fingerprint, text)
    signature = signer.sign(message)
    attachment = PositionAttachment(publisher_id="bench", count=1, signed=text, signature=signature)
    sample = Sample(POSITION.key(edge.LEADER), b"", json_message.encode(attachment), 0.0)
    wrong = attachment.model_copy(update={"signed": text.replace("run", "hold")})
    forged = Sample(POSITION.key(edge.NEIGHBOUR), b"", json_message.encode(wrong), 0.0)
    wall = time.time()
    certified, _ = next(iter(verifier._certificates.values()))
    return {
        "sign an order": microseconds(lambda: signer.sign(message)),
        "verify an order": microseconds(lambda: certified.verifies(signature, message)),
        "a beat that another neighbour has brought": microseconds(lambda: verifier.check(sample, wall)),
        "a forged order of a flood": microseconds(lambda: verifier.check(forged, wall)),
        "read a certificate": microseconds(lambda: verifier._read(signer.certificate)),
    }


def imported() -> dict[str, float]:
    """What importing the signing costs an agent: time [ms] and memory [MiB]."""
    program = (
        "import time, formation.agent.core, formation.transport.security.verifying\n"
        "peak = lambda: int(open('/proc/self/statm').read().split()[1]) * 4\n"
        "before, start = peak(), time.perf_counter()\nimport formation.transport.security.signing\n"
        "print(1e3 * (time.perf_counter() - start), (peak() - before) / 1024)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    took, memory = map(float, run.stdout.split())
    return {"import [ms]": took, "memory [MiB]": memory}


def measure(rounds: int) -> Any:
    """All figures, by rounds."""
    found = []
    with TemporaryDirectory() as folder:
        for _ in range(rounds):
            primitive = primitives(*keys(Path(folder)))
            found.append(periods(*keys(Path(folder))) | primitive | imported())
    return over_rounds(found)


def section(found: Any) -> str:
    """The figures in Markdown."""
    rows = [(name, span(took, 1)) for name, took in found.items()]
    return markdown(("signed orders, two neighbours, 20 Hz", "µs"), rows)


if __name__ == "__main__":
    command(__doc__, measure, section)
