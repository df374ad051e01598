"""The sentence that says how a recorded run went."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from formation.monitor.report.summary import verdict


def test_a_run_that_has_just_settled_says_the_rule() -> None:
    snapshot = SimpleNamespace(final_error=0.01, settled_at=4.5, converged=False)
    run: Any = SimpleNamespace(
        mission=SimpleNamespace(settled=0.05), messages=1, known=True, snapshot=snapshot
    )
    assert verdict(run).startswith("Just settled: under ")
    assert verdict(run).endswith("; converged means under it for at least 2 s.")
    snapshot.converged = True
    assert verdict(run).startswith("Converged: ")
