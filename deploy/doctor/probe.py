"""Dial an agent as Zenoh would, up to the handshake, and report the result. No message is sent."""

from __future__ import annotations

import errno
import socket
import ssl
from pathlib import Path
from typing import NamedTuple

from formation.deploy.doctor.facts import Outcome, Reached

CONNECT_TIMEOUT_SECONDS = 2.0
"""Time for a connection, and for a handshake [s]."""
LATE_REFUSAL_TIME = 0.3
"""Time after our half of a TLS 1.3 handshake in which the other side may still refuse [s]."""
GONE = {errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EHOSTDOWN, errno.ENETDOWN}


class Papers(NamedTuple):
    """The files of a process's TLS identity, as named in its Zenoh configuration."""

    trusted: Path
    certificate: Path
    key: Path


def reach(endpoint: str, papers: Papers | None) -> Reached:
    """Dial `endpoint`; without papers only connect to a TLS endpoint, without a handshake."""
    protocol, _, place = endpoint.partition("/")
    host, _, port = place.partition("?")[0].partition("#")[0].rpartition(":")
    host = host.strip("[]")
    if protocol not in {"tcp", "tls"}:
        return Reached(endpoint, "ok", f"{protocol} is not dialled")
    try:
        with socket.create_connection((host, int(port)), CONNECT_TIMEOUT_SECONDS) as plain:
            if protocol == "tcp" or papers is None:
                return Reached(endpoint, "ok")
            return _handshake(endpoint, plain, host, papers)
    except OSError as error:
        return Reached(endpoint, _outcome(error), str(error))


def context(papers: Papers, *, server: bool = False) -> ssl.SSLContext:
    """Return a TLS context like Zenoh's mTLS with these papers. OSError (or SSLError) on failure."""
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    made.load_verify_locations(papers.trusted)
    made.load_cert_chain(papers.certificate, papers.key, password="")
    made.verify_mode = ssl.CERT_REQUIRED
    return made


def common_name(certificate: object) -> str:
    """Return the common name in a result of `SSLSocket.getpeercert`."""
    subject = certificate.get("subject", ()) if isinstance(certificate, dict) else ()
    names = [value for part in subject for key, value in part if key == "commonName"]
    return str(names[0]) if names else ""


def _handshake(endpoint: str, plain: socket.socket, host: str, papers: Papers) -> Reached:
    try:
        ours = context(papers)
    except OSError as error:  # the examination of certificates reports more
        return Reached(endpoint, "turned away", f"ours cannot be used: {error}")
    try:
        with ours.wrap_socket(plain, server_hostname=host) as secure:
            name = common_name(secure.getpeercert())
            secure.settimeout(LATE_REFUSAL_TIME)
            try:
                secure.recv(1)
            except TimeoutError:
                return Reached(endpoint, "ok", name=name)  # it waits for our first message
            return Reached(endpoint, "turned away", "it hung up", name)
    except ssl.SSLCertVerificationError as error:
        return Reached(endpoint, "untrusted", error.verify_message)
    except ssl.SSLError as error:
        return Reached(endpoint, *_alert(error))


def _alert(error: ssl.SSLError) -> tuple[Outcome, str]:
    reason = (error.reason or str(error)).replace("_", " ").lower()
    if "wrong version" in reason or "record layer" in reason or "http request" in reason:
        return "no TLS", reason
    return "turned away", reason.partition("alert ")[2] or reason


def _outcome(error: OSError) -> Outcome:
    if isinstance(error, socket.gaierror):
        return "unknown name"
    if isinstance(error, ConnectionRefusedError):
        return "refused"
    if error.errno in GONE:
        return "no route"
    return "turned away" if isinstance(error, ConnectionResetError) else "no answer"
