"""Read certificates with Python's standard library only, as a robot has no other."""

from __future__ import annotations

import ssl
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from formation.deploy.doctor.facts import Certificate
from formation.deploy.doctor.probe import Papers, common_name, context
from formation.deploy.refusal import Refusal
from formation.transport.bus import setting
from formation.transport.bus_config import BusError

NO_CHECK_TIME = 0x20_0000
"""OpenSSL's X509_V_FLAG_NO_CHECK_TIME: read expired certificates too."""


def papers_of(config: Path) -> Papers | None:
    """Return the TLS files of a Zenoh configuration; None if it has no TLS. Raises Refusal."""
    try:
        tls = setting(config, "transport/link/tls")
    except BusError as error:
        raise Refusal(str(error)) from None
    words = [
        tls.get(one) for one in ("root_ca_certificate", "connect_certificate", "connect_private_key")
    ] if tls else []  # fmt: skip
    return Papers(*map(Path, words)) if words and all(words) else None


def papers_in(folder: Path, names: Sequence[str]) -> Iterator[tuple[str, Papers]]:
    """Yield the papers of `names` found in `folder`, as made by `formation deploy certificates`.

    Raises Refusal if there are none.
    """
    found = {path.parent.name for path in folder.glob("*/certificate.pem")}
    if not found:
        raise Refusal(f"--certificates {folder}: holds none; `formation deploy certificates` makes them")
    for name in names:
        if name in found:
            home = folder / name
            yield name, Papers(home / "ca.pem", home / "certificate.pem", home / "key.pem")


def read(name: str, papers: Papers) -> Certificate | None:
    """Return the certificate of `name`; None if this user may not read it."""
    path, wanted = str(papers.certificate), name
    try:
        mode = stat.S_IMODE(papers.key.stat().st_mode)
        shown = _shown(papers)
    except PermissionError:
        return None
    except FileNotFoundError as error:
        return Certificate(path=path, wanted=wanted, problem=f"{error.filename or 'a file'} is missing")
    except ssl.SSLError as error:
        return Certificate(path=path, wanted=wanted, problem=_trouble(error))
    except OSError as error:
        return Certificate(path=path, wanted=wanted, problem=error.strerror or str(error))
    return Certificate(
        path=path,
        wanted=wanted,
        name=common_name(shown),
        begins=float(ssl.cert_time_to_seconds(str(shown["notBefore"]))),
        ends=float(ssl.cert_time_to_seconds(str(shown["notAfter"]))),
        mode=mode,
    )


def _shown(papers: Papers) -> dict[str, object]:
    """Return the certificate's content, after a handshake as a client with a server of the same authority."""
    server, client = context(papers, server=True), context(papers)
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


def _trouble(error: ssl.SSLError) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its authority does not vouch for it: {error.verify_message}"
    reason = (error.reason or "").replace("_", " ").lower()
    if "mismatch" in reason:
        return "the key does not belong to it"
    if not reason or reason.startswith(("pem", "no start line", "bad ")):
        return "it, its key or its authority's certificate is damaged"
    return f"it cannot be used: {reason or error}"
