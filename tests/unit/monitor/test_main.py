"""The monitor's process before its bus is open."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Never

import pytest

from formation.mission.file import read
from formation.monitor import __main__ as monitor
from formation.transport.bus_config import BusError


def no_bus(*_: Any) -> Never:
    raise BusError("no bus in this test")


@pytest.mark.parametrize(("protocol", "warned"), [("tls", True), ("tcp", False)])
def test_monitor_without_certificate_says_which_file_has_one(
    protocol: str,
    warned: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    file = tmp_path / "pair.toml"
    leader = f'[robots.leader]\nendpoint = "{protocol}/192.168.1.10:7460"'
    file.write_text(read("turtlebot3_pair")[0].replace("[robots.leader]", leader), encoding="utf-8")
    monkeypatch.setattr(monitor, "Bus", no_bus)
    assert monitor.main([str(file), "--no-record", "--no-page"]) == 2
    remedy = "robots with certificates answer only the monitor: name the folder of their bundles"
    assert (remedy in caplog.text) is warned
