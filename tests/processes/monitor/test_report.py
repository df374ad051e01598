"""`formation report` of a real run: the monitor's own metrics, in a real browser without network."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from playwright.sync_api import Request

from formation.deploy.cli import main
from tests.support.launched import result_of, started
from tests.support.served import browsing

pytestmark = [pytest.mark.processes, pytest.mark.browser]


@pytest.mark.timeout(300)
def test_report_equals_monitor_metrics_and_needs_no_network(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with started("six_robots", "--duration", "12", "--record", "run.mcap", folder=tmp_path) as process:
        live = result_of(process)
    assert main(["report", str(tmp_path / "run.mcap"), "--json"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert run["formation_error"] == live["formation_error"]
    assert run["converged"] == live["converged"]
    assert run["messages"] == live["recorded"]
    if live["settling_time"] is None:
        assert run["settling_time"] is None
    else:  # live by the monotonic clock, here by the system clock
        assert run["settling_time"] == pytest.approx(live["settling_time"], abs=2e-3)

    requested: list[str] = []
    wrong: list[str] = []

    def note(request: Request) -> None:
        requested.append(request.url)

    page_file = (tmp_path / "run.html").as_uri()
    with browsing() as browser:
        for width in (1280, 390):
            window = browser.new_context(offline=True, viewport={"width": width, "height": 900})
            page = window.new_page()
            page.on("request", note)
            page.on("console", lambda message: wrong.append(message.text))
            page.on("pageerror", lambda error: wrong.append(str(error)))
            page.goto(page_file)
            assert page.locator("svg[role=img]").count() == 8
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            titles, values = (page.locator(f".cards {tag}").all_inner_texts() for tag in ("dt", "dd"))
            cards = dict(zip(titles, values, strict=True))
            if run["settling_time"] is not None:
                assert cards["settling time"] == f"{run['settling_time']:.2f} s"
            assert cards["messages"] == f"{run['messages']:,}"
            window.close()
    assert requested == [page_file, page_file]
    assert wrong == []
