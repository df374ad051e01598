"""What the other tests of processes stand on."""

from __future__ import annotations

from tests.support.child import free_endpoint


def test_endpoints_drawn_together_differ() -> None:
    assert len({free_endpoint() for _ in range(1_000)}) == 1_000
