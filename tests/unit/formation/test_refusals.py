"""Refusals of Zenoh are counted from its log: by kind, each once, among other lines."""

from __future__ import annotations

import pytest

from formation.transport.security.refusals import MAX_KIND_CHARS, MAX_KINDS, OTHER, Parser

ZID, OTHERS = "853284b9103ab54f9afc4919b38c7852", "2b909cbc29257a331cca0908affe6d7b"
STAMP = "2026-11-21T04:54:40.088745Z"
RULES = "zenoh::net::routing::interceptor::access_control:"
CHAIN = "zenoh::net::routing::interceptor:"
TLS = f"{STAMP}  WARN app-0 ThreadId(02) zenoh_link_tls::unicast:"


def decided(what: str, key: str, by: str = "robot2", zid: str = ZID, thread: int = 2, un: str = "un") -> str:
    subject = f"Interface(lo)+CertCommonName({by})+Transport(Tls)+{zid}"
    return (
        f"{STAMP} TRACE app-0 ThreadId({thread:02}) {RULES} {zid} on {subject} is"
        f" {un}authorized to {what} on {key}"
    )


def cached_decision(what: str, key: str, zid: str = ZID, un: str = "un") -> str:
    return (
        f"{STAMP} TRACE app-0 ThreadId(02) {RULES} Using cached result: {zid} is"
        f" {un}authorized to {what} on {key}"
    )


def intercepted(thread: int = 2) -> str:
    return f"{STAMP} TRACE app-0 ThreadId({thread:02}) {CHAIN} Msg intercepted!"


def read(*lines: str, namespace: str = "") -> tuple[dict[str, int], list[str]]:
    parser = Parser(namespace)
    reported = list(parser.feed("".join(line + "\n" for line in lines).encode()))
    return dict(parser.counts), reported


def test_refused_put_is_counted_by_key_and_certificate() -> None:
    counts, reported = read(decided("Put (ingress)", "robot3/position"), intercepted())
    assert counts == {"put robot3/position by robot2": 1}
    assert reported == ["refused: put robot3/position by robot2"]


def test_decisions_without_refused_message_are_not_counted() -> None:
    caching = [decided(f"{what} (ingress)", "robot2/position") for what in ("Query", "Reply", "Delete")]
    allowed = decided("Put (ingress)", "robot2/position", un="")
    assert read(*caching, allowed, cached_decision("Put (ingress)", "robot2/position", un="")) == ({}, [])
    assert read(*caching, allowed, intercepted()) == ({}, [])


def test_cached_refusal_is_counted_with_known_name() -> None:
    first = decided("Put (ingress)", "robot1/alive")
    again = cached_decision("Liveliness Token (ingress)", "robot1/alive")
    counts, _ = read(first, again, intercepted())
    assert counts == {"liveliness token robot1/alive by robot2": 1}
    unknown = cached_decision("Delete (ingress)", "robot1/position", zid=OTHERS)
    assert read(unknown, intercepted())[0] == {"delete robot1/position": 1}


def test_refused_egress_is_not_counted() -> None:
    assert read(decided("Declare Subscriber (egress)", "robot1/position"), intercepted()) == ({}, [])


def test_lines_of_two_threads_do_not_mix() -> None:
    counts, _ = read(
        decided("Put (ingress)", "robot3/position", thread=2),
        decided("Put (egress)", "robot1/position", thread=1, un=""),
        intercepted(thread=2),
        intercepted(thread=1),
    )
    assert counts == {"put robot3/position by robot2": 1}


def test_namespace_is_removed_from_keys() -> None:
    lines = (decided("Query (ingress)", "reds/robot3/order"), intercepted())
    assert read(*lines, namespace="reds")[0] == {"query robot3/order by robot2": 1}


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("invalid peer certificate: UnknownIssuer. Hint: …", "certificate: unknown issuer"),
        ("invalid peer certificate: BadSignature. Hint: …", "certificate: bad signature"),
        (
            "invalid peer certificate: certificate expired: verification time 1795237017 (UNIX), but …",
            "certificate: expired",
        ),
        ("invalid peer certificate: certificate not valid yet: …", "certificate: not valid yet"),
        ("invalid peer certificate: InvalidPurpose. Hint: …", "certificate: invalid"),
        ("peer sent no certificates. Hint: …", "certificate: none"),
        ("received corrupt message of type InvalidContentType. Hint: …", "not TLS"),
        ("received fatal alert: UnknownCA. Hint: …", "certificate: ours, which the other side does not take"),
        ("tls handshake eof. Hint: …", "handshake broken off"),
    ],
)
def test_refused_links_are_counted_by_cause(text: str, kind: str) -> None:
    assert read(f"{TLS} {text}") == ({kind: 1}, [f"refused: {kind}"])


def test_refused_certificate_of_dialled_peer_is_counted() -> None:
    line = (
        f"{STAMP} DEBUG net-0 ThreadId(03) zenoh::net::runtime::orchestrator: Unable to connect to configured"
        " peer tls/10.77.0.1:7460! Can not create a new TLS link bound to IpAddress(V4(…)):"
    )
    counts, reported = read(
        f"{line} invalid peer certificate: certificate expired: verification time …",
        f'{line} invalid peer certificate: certificate not valid for name "10.77.0.1"; …',
        f"{line} [10.77.0.1:7460: Connection refused (os error 111) at …",
    )
    dialling = "dialling tls/10.77.0.1:7460: certificate"
    assert counts == {f"{dialling}: expired": 1, f"{dialling}: of another place": 1}
    assert len(reported) == 2


def test_expiry_during_a_link_has_its_own_kind() -> None:
    line = (
        f"{STAMP}  WARN app-1 ThreadId(03) zenoh_link_commons::tls::expiration:"
        " Closing TLS link 10.77.0.1:7460 => 10.77.0.2:41884 : remote certificate chain expired"
    )
    assert read(line)[0] == {"certificate: expired during the link": 1}


def test_certificate_without_access_rule_is_counted() -> None:
    line = f"{STAMP} DEBUG app-0 ThreadId(02) {RULES} {ZID} did not match any configured ACL subject. Default"
    assert read(line, intercepted())[0] == {"certificate: of no process in the mission": 1}


def test_only_other_warnings_and_errors_are_passed_on() -> None:
    warning = f"{STAMP}  WARN app-0 ThreadId(02) zenoh_transport::unicast: something is wrong"
    error = f"{STAMP} ERROR app-0 ThreadId(02) zenoh_link_tls::unicast: out of memory"
    info = f"{STAMP}  INFO app-0 ThreadId(02) zenoh_transport::unicast: all is well"
    counts, reported = read(warning, info, error)
    assert counts == {}
    assert reported == [f"zenoh: {warning}", f"zenoh: {error}"]


@pytest.mark.parametrize(
    "text",
    [
        "Unable to connect to tcp/127.0.0.1:7447! Can not create a new TCP link bound to tcp/127.0.0.1:7447",
        "Unable to connect to any of [Single(tcp/127.0.0.1:7447)]! ",
    ],
)
def test_unreachable_router_is_not_reported_as_refusal(text: str) -> None:
    line = f"{STAMP}  WARN ThreadId(04) zenoh::net::runtime::orchestrator: {text}"
    assert read(line) == ({}, [])


def test_parser_reads_log_in_any_pieces_and_coloured() -> None:
    lines = decided("Put (ingress)", "robot3/position") + "\n" + intercepted() + "\n"
    log = "\x1b[2m" + lines.replace("TRACE", "\x1b[35mTRACE\x1b[0m") * 3
    for size in (1, 7, 100):
        parser = Parser()
        for start in range(0, len(log), size):
            list(parser.feed(log.encode()[start : start + size]))
        assert parser.counts == {"put robot3/position by robot2": 3}


def test_memory_of_parser_is_bounded() -> None:
    parser = Parser()
    for number in range(3 * MAX_KINDS):
        zid = f"{number:032x}"
        lines = (
            decided("Put (ingress)", f"k{number}/" + "x" * 500, zid=zid, thread=number),
            intercepted(number),
        )
        list(parser.feed("".join(f"{line}\n" for line in lines).encode()))
    assert len(parser.counts) == MAX_KINDS + 1
    assert parser.counts[OTHER] == 2 * MAX_KINDS
    assert max(map(len, parser.counts)) <= MAX_KIND_CHARS
    assert parser.counts.total() == 3 * MAX_KINDS
    list(parser.feed(b"x" * 1_000_000))
    assert len(parser._rest) <= 4096
    assert len(parser._names) <= MAX_KINDS
    assert len(parser._pending) <= MAX_KINDS


def test_repeated_refusals_are_logged_at_powers_of_ten() -> None:
    counts, reported = read(*(decided("Put (ingress)", "a"), intercepted()) * 1000)
    assert counts == {"put a by robot2": 1000}
    assert len(reported) == 4
    assert reported[-1] == "refused: put a by robot2, 1000 times"


def test_control_characters_in_keys_are_replaced() -> None:
    counts, _ = read(decided("Put (ingress)", "a\x07\x1b[2Jb"), intercepted())
    assert counts == {"put a??[2Jb by robot2": 1}
