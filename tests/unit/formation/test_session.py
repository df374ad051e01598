"""What is said if Zenoh cannot open a session."""

from __future__ import annotations

from typing import Any

import pytest
import zenoh

from formation.transport import session
from formation.transport.bus_config import BusConfig, BusError


def test_listening_without_a_certificate_names_the_flag(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: Any) -> None:
        raise zenoh.ZError("Cannot create a new TLS listener on 127.0.0.1:7461. Missing TLS private key.")

    monkeypatch.setattr(zenoh, "open", fail)
    settings = session.settings_of(BusConfig(listen=("tls/127.0.0.1:7461",)))
    with pytest.raises(BusError) as caught:
        session.opened(settings, "agent robot2")
    assert str(caught.value) == (
        "cannot listen on tls/127.0.0.1:7461 without a certificate: -c FILE names a configuration with one"
    )
