"""Read Zenoh's log from standard output, in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.unit.formation.test_refusals import TLS, decided, intercepted


def run(body: str) -> subprocess.CompletedProcess[str]:
    """Run `body` in a process: it writes a log as Zenoh does, to descriptor 1, bypassing Python."""
    begin = "import os, logging\nfrom formation.transport.security.refusals import Refusals, FILTER\n"
    begin += (
        "from formation.transport.runtime.process import say\nlogging.basicConfig(format='%(message)s')\n"
    )
    begin += "say('before')\n"
    return subprocess.run(
        [sys.executable, "-c", begin + body],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        cwd=Path(__file__).parents[3],
    )


def test_events_stay_on_stdout_and_log_on_stderr() -> None:
    done = run(
        f"""
seen = []
refusals = Refusals.listen(lambda: seen.append(os.environ['RUST_LOG']))
assert seen == [FILTER] and 'RUST_LOG' not in os.environ
assert Refusals.listen(lambda: seen.append('twice')) is refusals
for number in range(500):
    os.write(1, {(decided("Put (ingress)", "a") + chr(10)).encode()!r})
    os.write(1, {(intercepted() + chr(10)).encode()!r})
    say('event', number=number)
os.write(1, {(TLS[:-1] + "s: odd" + chr(10)).encode()!r})
say('counts', **refusals.counts)
"""
    )
    result = [json.loads(line) for line in done.stdout.splitlines()]
    assert [event["event"] for event in result] == ["before", *["event"] * 500, "counts"]
    assert result[-1] == {"event": "counts", "put a by robot2": 500}
    assert "refused: put a by robot2, 100 times" in done.stderr
    assert [line for line in done.stderr.splitlines() if line.endswith("odd")]


def test_pipe_is_emptied_before_its_content_is_parsed() -> None:
    """While a full pipe is parsed, Zenoh can write as much again."""
    done = run(
        f"""
refusals = Refusals.listen(lambda: None)
refusal = {(decided("Put (ingress)", "a") + chr(10) + intercepted() + chr(10)).encode()!r}
written = []
def fill():
    written.append(0)
    try:
        while os.write(1, refusal):
            written[-1] += 1
    except BlockingIOError:
        pass
feed = refusals._parser.feed
def refilled(piece):
    if len(written) == 1:
        fill()
    return feed(piece)
with refusals._lock:
    refusals._parser.feed = refilled
    fill()
while refusals.counts.total() < sum(written):
    pass
say('written', times=written, counted=refusals.counts.total())
"""
    )
    result = json.loads(done.stdout.splitlines()[-1])
    first, second = result["times"]
    assert second >= first > 0
    assert result["counted"] == first + second


def test_unread_log_neither_blocks_nor_grows() -> None:
    done = run(
        """
import time, sys
refusals = Refusals.listen(lambda: None)
refusals._lock.acquire()  # the reader hangs
start, lost = time.monotonic(), 0
for _ in range(100_000):
    try:
        os.write(1, b'x' * 99 + b'\\n')
    except BlockingIOError:
        lost += 1
assert lost > 50_000, lost
refusals._lock.release()
assert not refusals.counts
"""
    )
    assert done.returncode == 0
