"""One real run for all tests that read a recording of one."""

from __future__ import annotations

import pytest

from tests.processes.monitor.replayed import Run, drive


@pytest.fixture(scope="session")
def run_of_six(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return drive(tmp_path_factory.mktemp("run"), 20)
