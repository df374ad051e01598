"""Open a Zenoh session for a `BusConfig`, and close it."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from formation.transport.bus_config import DEFAULTS, BusConfig, BusError, plain
from formation.transport.security.refusals import Refusals

_log = logging.getLogger(__name__)


class Identity(NamedTuple):
    """The files with which a process authenticates itself and others on its links (mTLS)."""

    authority: Path
    """Certificate of the authority that it trusts."""
    key: Path | None
    certificate: Path | None
    """Certificate of the process itself."""


def identity_of(config: BusConfig) -> Identity | None:
    """The identity of a process with this configuration; None for one without certificates.

    Raises BusError if both sides of a link must authenticate, and no file contains the authority.
    """
    tls = json.loads(settings_of(config).get_json("transport/link/tls"))
    if not tls["enable_mtls"]:
        return None
    if not tls["root_ca_certificate"]:
        raise BusError(
            "transport/link/tls: enable_mtls needs root_ca_certificate, the authority's certificate in a"
            " file, by which orders are verified"
        )
    key, certificate = (
        Path(one) if (one := tls[f"connect_{what}"] or tls[f"listen_{what}"]) else None
        for what in ("private_key", "certificate")
    )
    return Identity(Path(tls["root_ca_certificate"]), key, certificate)


def setting(file: Path, path: str) -> Any:
    """The value at `path` of a Zenoh configuration file (JSON5), or Zenoh's default. Raises BusError."""
    with named(f"--config {str(file)!r}"):
        return json.loads(zenoh.Config.from_file(file).get_json(path))


def opened(settings: zenoh.Config, name: str) -> zenoh.Session:
    """A session with these settings, of a process called `name`. Raises BusError."""
    listened = ", ".join(json.loads(settings.get_json("listen/endpoints"))) or "nothing"
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        if "in use" in str(error):
            twice = f"; is there a second {name} on this machine?" if name else ""
            raise BusError(f"cannot listen on {listened}: the address is in use{twice}") from None
        if "Unable to connect" in str(error):
            dialled = ", ".join(json.loads(settings.get_json("connect/endpoints")))
            raise BusError(f"no router answers at {dialled}: is it running there?") from None
        if "Missing TLS private key" in str(error):
            raise BusError(
                f"cannot listen on {listened} without a certificate: -c FILE names a configuration with one"
            ) from None
        raise BusError(f"the bus cannot be opened, listening on {listened}: {plain(error)}") from None


def settings_of(config: BusConfig) -> zenoh.Config:
    """Zenoh's settings: defaults, the file, the mission's, flags, overrides. Raises BusError."""
    settings, untouched = zenoh.Config(), zenoh.Config()
    if config.config_file is not None:
        with named(f"--config {str(config.config_file)!r}"):
            settings = zenoh.Config.from_file(config.config_file)

    def left_open(path: str) -> bool:
        return bool(json.loads(settings.get_json(path)) == json.loads(untouched.get_json(path)))

    linked = not all(map(left_open, ("listen/endpoints", "connect/endpoints")))
    defaults = [(path, value) for path, value in DEFAULTS if left_open(path)]
    for path, value in defaults + ([] if linked else config.links()) + config.flags():
        settings.insert_json5(path, value)
    for path, value in config.overrides:
        with named(f"--cfg {path}:{value}: must be one of Zenoh's paths, and JSON5 with text in quotes"):
            settings.insert_json5(path, value)
    return settings


def refusals_of(settings: zenoh.Config) -> Refusals | None:
    """The counter of refusals of a session with these settings; None if it cannot refuse any."""
    if not json.loads(settings.get_json("access_control/enabled")):
        return None
    namespace = json.loads(settings.get_json("namespace"))
    return Refusals.listen(zenoh.try_init_log_from_env, namespace or "")


def closed(session: zenoh.Session) -> None:
    """Close it; a failure is logged."""
    try:
        session.close()  # type: ignore[no-untyped-call]
    except zenoh.ZError as error:
        _log.warning("the bus did not close cleanly: %s", plain(error))


@contextmanager
def named(what: str) -> Iterator[None]:
    """Turn Zenoh's errors into a BusError that names `what`."""
    try:
        yield
    except zenoh.ZError as error:
        raise BusError(f"{what}: {plain(error)}") from None
