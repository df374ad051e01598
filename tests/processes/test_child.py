"""What the other tests of processes stand on."""

from __future__ import annotations

from tests.processes.child import free_endpoint


def test_endpoints_that_are_asked_for_together_differ_though_nobody_listens_yet() -> None:
    assert len({free_endpoint() for _ in range(1_000)}) == 1_000
