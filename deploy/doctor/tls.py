"""A process's TLS files: read them, and dial an agent as Zenoh would, up to the handshake.

Only Python's standard library is used, as a robot has no other. No message is sent.
"""

from __future__ import annotations

import errno
import socket
import ssl
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from formation.deploy.doctor.facts import Certificate, Outcome, Reached
from formation.deploy.refusal import Refusal, refuse_errors
from formation.transport.bus import setting
from formation.transport.bus_config import BusError

CONNECT_TIMEOUT_SECONDS = 2.0
"""Time for a connection, and for a handshake [s]."""
LATE_REFUSAL_TIME = 0.3
"""Time after our half of a TLS 1.3 handshake in which the other side may still refuse [s]."""
UNREACHABLE_ERRNOS = {errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EHOSTDOWN, errno.ENETDOWN}
NO_CHECK_TIME = 0x20_0000
"""OpenSSL's X509_V_FLAG_NO_CHECK_TIME: read expired certificates too."""


class Credentials(NamedTuple):
    """The files of a process's TLS identity, as named in its Zenoh configuration."""

    trusted: Path
    certificate: Path
    key: Path


def credentials_of(config: Path) -> Credentials | None:
    """Return the TLS files of a Zenoh configuration; None if it has no TLS. Raises Refusal."""
    with refuse_errors(BusError):
        tls = setting(config, "transport/link/tls")
    names = "root_ca_certificate", "connect_certificate", "connect_private_key"
    words = [str((tls or {}).get(name) or "") for name in names]
    return Credentials(*map(Path, words)) if all(words) else None


def credentials_in(folder: Path, names: Sequence[str]) -> dict[str, Credentials]:
    """Return the credentials of `names` found in `folder`, as made by `formation deploy certificates`.

    Raises Refusal if there are none.
    """
    found = {path.parent.name for path in folder.glob("*/certificate.pem")}
    if not found:
        raise Refusal(f"--certificates {folder}: holds none; `formation deploy certificates` makes them")
    homes = {name: folder / name for name in names if name in found}
    files = "ca.pem", "certificate.pem", "key.pem"
    return {name: Credentials(*(home / file for file in files)) for name, home in homes.items()}


def read(name: str, credentials: Credentials) -> Certificate | None:
    """Return the certificate of `name`; None if this user may not read it."""
    path, wanted = str(credentials.certificate), name
    try:
        mode = stat.S_IMODE(credentials.key.stat().st_mode)
        shown = _certificate_content(credentials)
    except PermissionError:
        return None
    except FileNotFoundError as error:
        return Certificate(path=path, wanted=wanted, problem=f"{error.filename or 'a file'} is missing")
    except ssl.SSLError as error:
        return Certificate(path=path, wanted=wanted, problem=_certificate_problem(error))
    except OSError as error:
        return Certificate(path=path, wanted=wanted, problem=error.strerror or str(error))
    return Certificate(
        path=path,
        wanted=wanted,
        name=_common_name(shown),
        begins=float(ssl.cert_time_to_seconds(str(shown["notBefore"]))),
        ends=float(ssl.cert_time_to_seconds(str(shown["notAfter"]))),
        mode=mode,
    )


def context(credentials: Credentials, *, server: bool = False) -> ssl.SSLContext:
    """Return a TLS context like Zenoh's mTLS with these credentials. OSError (or SSLError) on failure."""
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    made.load_verify_locations(credentials.trusted)
    made.load_cert_chain(credentials.certificate, credentials.key, password="")
    made.verify_mode = ssl.CERT_REQUIRED
    return made


def dial(endpoint: str, credentials: Credentials | None) -> Reached:
    """Dial `endpoint`; without credentials only connect to a TLS endpoint, without a handshake."""
    protocol, _, place = endpoint.partition("/")
    host, _, port = place.partition("?")[0].partition("#")[0].rpartition(":")
    host = host.strip("[]")
    if protocol not in {"tcp", "tls"}:
        return Reached(endpoint, "ok", f"{protocol} is not dialled")
    try:
        with socket.create_connection((host, int(port)), CONNECT_TIMEOUT_SECONDS) as plain:
            if protocol == "tcp" or credentials is None:
                return Reached(endpoint, "ok")
            return _handshake(endpoint, plain, host, credentials)
    except OSError as error:
        return Reached(endpoint, _outcome(error), str(error))
    except UnicodeError as error:  # a host name that cannot be one
        return Reached(endpoint, "unknown name", str(error))


def _certificate_content(credentials: Credentials) -> dict[str, object]:
    """Return the certificate's content, after a handshake as a client with a server of the same authority."""
    server, client = context(credentials, server=True), context(credentials)
    server.verify_flags |= NO_CHECK_TIME
    client.check_hostname = False
    client.verify_mode = ssl.CERT_NONE  # a process that only dials needs no server certificate
    one, other = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        server.wrap_bio(one, other, server_side=True),
        client.wrap_bio(other, one),
    ]
    done: set[int] = set()
    while len(done) < len(ends):
        for number, end in enumerate(ends):
            try:
                end.do_handshake()
                done.add(number)
            except ssl.SSLWantReadError:
                continue
    return dict(ends[0].getpeercert() or {})


def _certificate_problem(error: ssl.SSLError) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its authority does not vouch for it: {error.verify_message}"
    reason = (error.reason or "").replace("_", " ").lower()
    if "mismatch" in reason:
        return "the key does not belong to it"
    if not reason or reason.startswith(("pem", "no start line", "bad ")):
        return "it, its key or its authority's certificate is damaged"
    return f"it cannot be used: {reason or error}"


def _common_name(certificate: object) -> str:
    subject = certificate.get("subject", ()) if isinstance(certificate, dict) else ()
    names = [value for part in subject for key, value in part if key == "commonName"]
    return str(names[0]) if names else ""


def _handshake(endpoint: str, plain: socket.socket, host: str, credentials: Credentials) -> Reached:
    try:
        ours = context(credentials)
    except OSError as error:  # the examination of certificates reports more
        return Reached(endpoint, "turned away", f"ours cannot be used: {error}")
    try:
        with ours.wrap_socket(plain, server_hostname=host) as secure:
            name = _common_name(secure.getpeercert())
            secure.settimeout(LATE_REFUSAL_TIME)
            try:
                secure.recv(1)
            except TimeoutError:
                return Reached(endpoint, "ok", name=name)  # it waits for our first message
            return Reached(endpoint, "turned away", "it hung up", name)
    except ssl.SSLCertVerificationError as error:
        return Reached(endpoint, "untrusted", error.verify_message)
    except ssl.SSLError as error:
        return Reached(endpoint, *_refusal(error))


def _refusal(error: ssl.SSLError) -> tuple[Outcome, str]:
    reason = (error.reason or str(error)).replace("_", " ").lower()
    if "wrong version" in reason or "record layer" in reason or "http request" in reason:
        return "no TLS", reason
    return "turned away", reason.partition("alert ")[2] or reason


def _outcome(error: OSError) -> Outcome:
    if isinstance(error, socket.gaierror):
        return "unknown name"
    if isinstance(error, ConnectionRefusedError):
        return "refused"
    if error.errno in UNREACHABLE_ERRNOS:
        return "no route"
    return "turned away" if isinstance(error, ConnectionResetError) else "no answer"
