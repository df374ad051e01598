"""What the tests of this folder share: bundles are made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.field import deployed


@pytest.fixture(scope="session")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bundles of `deployed.TEXT` for this machine, wheels and all; not to be changed."""
    return deployed.bundles(tmp_path_factory.mktemp("bundles"))
