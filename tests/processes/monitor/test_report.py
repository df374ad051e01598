"""`formation report` of a real run: the monitor's own metrics, in a real browser without network."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Request

from formation.deploy.cli import main
from tests.processes.monitor.replayed import Run

pytestmark = [pytest.mark.processes, pytest.mark.browser]


def test_report_equals_monitor_metrics_and_needs_no_network(
    run_of_six: Run, tmp_path: Path, browser: Browser, capsys: pytest.CaptureFixture[str]
) -> None:
    live, file = run_of_six.result, tmp_path / "run.html"
    assert main(["report", str(run_of_six.path), "--out", str(file), "--json"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert run["formation_error"] == live["formation_error"]
    assert run["converged"] == live["converged"]
    assert run["messages"] == live["recorded"]
    # live by the monotonic clock, here by the system clock
    assert run["settling_time"] == pytest.approx(live["settling_time"], abs=2e-3)

    requested: list[str] = []
    wrong: list[str] = []

    def note(request: Request) -> None:
        requested.append(request.url)

    for width in (1280, 390):
        window = browser.new_context(offline=True, viewport={"width": width, "height": 900})
        page = window.new_page()
        page.on("request", note)
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(file.as_uri())
        assert page.locator("svg[role=img]").count() == 8
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        titles, values = (page.locator(f".cards {tag}").all_inner_texts() for tag in ("dt", "dd"))
        cards = dict(zip(titles, values, strict=True))
        if run["settling_time"] is not None:
            assert cards["settling time"] == f"{run['settling_time']:.2f} s"
        assert cards["messages"] == f"{run['messages']:,}"
        window.close()
    assert requested == [file.as_uri(), file.as_uri()]
    assert wrong == []
