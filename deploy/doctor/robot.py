"""Examine what an agent depends on: its robot, a watchdog, odometry, clocks and certificates."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from formation.control.tracker import FRESH_PERIODS
from formation.deploy.doctor.facts import Examination, Facts, Finding, Stream
from formation.deploy.fleet.fleet import EXPIRING_LIFE_SHARE, RENEW
from formation.deploy.fleet.units import BRIDGES
from formation.protocol.status import RobotLink
from formation.protocol.status_codec import LINKS
from formation.ros2.tokens import hidden
from formation.topics import command_topic

OURS = frozenset(map(hidden, ("formation_agent", "formation_watchdog", "formation_doctor")))
"""ROS nodes that may publish on cmd_vel."""
KINDS = {"geometry_msgs/msg/Twist": "twist", "geometry_msgs/msg/TwistStamped": "twist_stamped"}
MIN_RATE_SHARE, MAX_RATE_SHARE = 0.8, 1.4
"""Lowest and highest share of the mission's rate."""
IRREGULAR_PAUSES = 2
"""Number of pauses while listening that counts as irregular; one may happen."""
MAX_REPEATED_SHARE = 0.5
"""Share of messages with a stamp that came before from which on a stream counts as frozen."""
CHRONY_LIMIT = 0.02
"""Offset from NTP time from which on it is reported [s]."""
OTHERS_MODE_BITS = 0o007
"""File mode bits of all other users."""


def _link(facts: Facts) -> Iterator[Finding]:
    if facts.router_error:
        yield Finding(
            "router-missing",
            f"nothing answers at {facts.router}, where the robot's bridge or router should be",
            f"sudo systemctl restart {(unit := _router_unit(facts))}; its log: journalctl -u {unit}",
        )
    wrong = [node for node in facts.subscribers if node.type != _wanted(facts)]
    for node in wrong:
        kind = KINDS.get(node.type)
        yield Finding(
            "cmd-vel-type",
            f"{node.name} takes {_short(node.type)} on cmd_vel, but is sent {_short(_wanted(facts))}",
            f'set cmd_vel = "{kind}" for {facts.robot} in the mission'
            if kind
            else "cmd_vel must be of type Twist or TwistStamped",
        )
    robot = facts.mission.robots.get(facts.robot)
    bridged = robot is not None and robot.ros == "ros2dds"
    remedy = f"restart the bring-up{' and the bridge together' if bridged else ''}"
    link = facts.agent.link if facts.agent else RobotLink.UNKNOWN
    if facts.routed is False and not wrong:
        yield Finding(
            "route-lost",
            f"nothing listens to cmd_vel: {'the bridge has lost its route, or ' if bridged else ''}"
            "the bring-up is down",
            remedy,
        )
    elif (
        link not in {RobotLink.UNKNOWN, RobotLink.CONNECTED}
        and facts.routed is None
        and not facts.router_error
    ):
        yield Finding(
            "route-lost",
            f"its agent's link to the robot: {LINKS[link]}",
            remedy,
        )
    for node in facts.publishers:
        if node.name not in OURS:
            yield Finding(
                "cmd-vel-contested",
                f"{node.name} publishes on cmd_vel as well",
                "end it: two controllers of one robot undo each other's work",
            )


def _router_unit(facts: Facts) -> str:
    """Return the usual unit of the robot's bridge or router."""
    return BRIDGES[facts.mission.robots[facts.robot].ros].removesuffix(".service")


def _link_seen(facts: Facts) -> str:
    if facts.routed:
        names = sorted({node.name for node in facts.subscribers})
        return (
            f"cmd_vel is listened to as {_short(_wanted(facts))}{' by ' if names else ''}{', '.join(names)}"
        )
    if facts.agent and facts.agent.link is RobotLink.CONNECTED:
        return "its agent says: connected"
    return ""


def _watchdog(facts: Facts) -> Iterator[Finding]:
    if facts.watchdog_unit not in {None, "active"}:
        yield Finding(
            "watchdog-down",
            f"the watchdog does not run: systemd calls it {facts.watchdog_unit}",
            "sudo systemctl restart formation-watchdog; journalctl -u formation-watchdog says why",
        )
    elif facts.watchdog_state == "" and not facts.router_error:
        yield Finding(
            "watchdog-down",
            "no watchdog answers: if the agent dies, the robot drives on",
            f"start it: formation watchdog MISSION --robot {facts.robot}",
        )


def _watchdog_seen(facts: Facts) -> str:
    if not facts.watchdog_state:
        return ""
    return f"answers: {facts.watchdog_state}{', systemd calls it active' if facts.watchdog_unit else ''}"


def _wanted(facts: Facts) -> str:
    """Return the ROS type of the commands that the agent sends."""
    return command_topic(facts.mission.robots[facts.robot].cmd_vel).type


def _short(ros_type: str) -> str:
    return ros_type.rpartition("/")[2]


def _odometry(facts: Facts) -> Iterator[Finding]:
    if facts.router_error:
        return  # one explains the other
    wanted = 1.0 / facts.period
    rates = wanted, MIN_RATE_SHARE * wanted, MAX_RATE_SHARE * wanted
    if facts.odometry is not None:
        yield from stream_findings(facts, "odometry", "odometry", facts.odometry, rates)
        yield from _frame(facts, facts.odometry)
    if facts.pose is not None:
        yield from stream_findings(facts, "pose", "the external pose", facts.pose, rates)


def _odometry_seen(facts: Facts) -> str:
    stream = facts.odometry
    if stream is None or not stream.received:
        return ""
    return f"{stream.rate:.3g} Hz, frame {', '.join(sorted(stream.frames)) or 'without a name'}"


def stream_findings(
    facts: Facts, name: str, what: str, stream: Stream, rates: tuple[float, float, float]
) -> Iterator[Finding]:
    """Yield what is wrong with a stream of messages.

    `rates` are the rate by the mission, the least and the greatest that are normal [Hz].
    """
    wanted, least, most = rates
    limit = FRESH_PERIODS / wanted
    rate, pauses = stream.rate, [gap for gap in stream.gaps if gap > limit]
    if stream.bad:
        yield Finding(
            f"{name}-unreadable",
            f"{len(stream.bad)} messages on {what} cannot be used: {stream.bad[-1]}",
            "see what publishes there, and with which type",
        )
    if not stream.received:
        if not stream.bad:
            yield Finding(
                f"{name}-silent",
                f"no {what.removeprefix('the ')} in {facts.seconds:g} s",
                "is the bring-up up, in the namespace and domain that the mission says?",
            )
    elif rate < least:
        yield Finding(
            f"{name}-slow",
            f"{what} comes at {rate:.3g} Hz instead of {wanted:.3g} Hz",
            "is the computer overloaded or hot (vcgencmd get_throttled)? else correct the mission's rate",
        )
    elif rate > most:
        yield Finding(
            f"{name}-fast",
            f"{what} comes at {rate:.3g} Hz instead of {wanted:.3g} Hz",
            "do two processes publish it? else correct the mission's rate",
        )
    elif (repeated := len(stream.received) - stream.stamps) > MAX_REPEATED_SHARE * len(stream.received):
        yield Finding(
            f"{name}-repeated",
            f"{what} is frozen: {repeated} of {len(stream.received)} messages repeat an earlier stamp",
            "restart what publishes it: it sends one message again and again",
        )
    elif len(pauses) >= IRREGULAR_PAUSES:
        yield Finding(
            f"{name}-irregular",
            f"{what} paused {len(pauses)} times in {facts.seconds:g} s, for up to {max(pauses):.2f} s",
            "each pause stops the robot: is the computer overloaded, is Wi-Fi power saving on?",
        )


def _frame(facts: Facts, stream: Stream) -> Iterator[Finding]:
    spec = facts.mission.robots[facts.robot]
    if len(stream.frames) > 1:
        yield Finding(
            "odometry-frames",
            f"odometry comes in several frames: {', '.join(sorted(stream.frames))}",
            "two processes publish it: end one of them",
        )
    in_world = spec.localisation == "odometry" and spec.odometry_frame == "world"
    if in_world and any(frame.rpartition("/")[2] == "odom" for frame in stream.frames):
        yield Finding(
            "odometry-frame",
            "odometry counts in its own frame odom, but the mission takes it for the world's",
            f'set odometry_frame = "start" in [robots.{facts.robot}], and switch it on at its start',
        )


def _clocks(facts: Facts) -> Iterator[Finding]:
    # an agent takes a larger offset for a long delay, and extrapolates too far: only the doctor reports that
    limit = 0.5 * FRESH_PERIODS * facts.period  # half the age at which a position counts as stale [s]
    for what, stream in _streams(facts):
        offset = _behind(stream)
        if offset is not None and abs(offset) > limit:
            yield Finding(
                "clock-offset",
                f"{what} is stamped {abs(offset):.3g} s {'ago' if offset > 0 else 'ahead'}, by this clock",
                "let chrony run on both machines: chronyc tracking",
            )
    for name, age in (facts.agent.clock if facts.agent else {}).items():
        yield Finding(
            "clock-doubted",
            f"its agent does not believe the stamps of {name}: {age:.3f} s old when they came",
            "let chrony run on both machines: chronyc tracking",
        )
    if facts.chrony is not None and not facts.chrony.synchronised:
        yield Finding(
            "clock-unsynchronised",
            "chrony has found no time server that it trusts",
            "see chronyc sources; the desk may be the server of the field",
        )
    elif facts.chrony is not None and abs(facts.chrony.offset) > CHRONY_LIMIT:
        yield Finding(
            "clock-not-settled",
            f"this machine's clock is {abs(facts.chrony.offset):.3g} s from its time server's",
            "wait until chronyc tracking says less, or chronyc makestep while nothing moves",
        )


def _clocks_seen(facts: Facts) -> str:
    offsets = [abs(offset) for _, stream in _streams(facts) if (offset := _behind(stream)) is not None]
    seen = [f"stamps within {max(offsets) * 1e3:.0f} ms"] if offsets else []
    if facts.chrony is not None:
        seen.append(f"chrony within {abs(facts.chrony.offset) * 1e3:.2g} ms")
    return ", ".join(seen)


def _behind(stream: Stream) -> float | None:
    """Return how far a sender's clock is behind ours [s]: the least one seen, as delays only add to it."""
    return min((one.behind for one in stream.received), default=None)


def _streams(facts: Facts) -> Iterator[tuple[str, Stream]]:
    for what, stream in (
        ("odometry", facts.odometry),
        ("the external pose", facts.pose),
        ("its position", facts.position),
        ("its status", facts.status),
    ):
        if stream is not None:
            yield what, stream


def _certificate_seen(facts: Facts) -> str:
    one = facts.certificate
    if one is None or one.problem:
        return ""
    return f"{one.name} is valid for {_span(one.ends - facts.wall)}"


def _span(seconds: float) -> str:
    """Return a duration for people."""
    if abs(seconds) >= 2 * 86_400:
        return f"{seconds / 86_400:.0f} days"
    return f"{seconds / 3_600:.1f} hours" if abs(seconds) >= 5_400 else f"{seconds / 60:.0f} minutes"


def _certificate(facts: Facts) -> Iterator[Finding]:
    one, now = facts.certificate, facts.wall
    if one is None:
        return
    if one.problem:
        yield Finding("certificate-unusable", f"{one.path}: {one.problem}", RENEW)
        return
    if one.name != one.wanted:
        yield Finding(
            "certificate-name",
            f"{one.path} is the certificate of {one.name!r}, not of {one.wanted!r}",
            "each process needs its own: make the bundles again, and push",
        )
    if one.mode & OTHERS_MODE_BITS:
        yield Finding(
            "key-readable",
            f"the key of {one.path} is readable by others (mode {one.mode:03o})",
            "chmod o= the key; if another user may have read it, renew it",
        )
    when = f"{datetime.fromtimestamp(one.ends, UTC):%Y-%m-%d %H:%M} UTC"
    if now >= one.ends:
        yield Finding("certificate-expired", f"{one.path} has expired on {when}", RENEW)
    elif now < one.begins:
        yield Finding(
            "certificate-not-yet-valid",
            f"{one.path} becomes valid in {_span(one.begins - now)}, by this machine's clock",
            "the clock is behind: set it, let chrony run",
        )
    elif one.ends - now < EXPIRING_LIFE_SHARE * (one.ends - one.begins):
        yield Finding(
            "certificate-expires", f"{one.path} expires on {when}, in {_span(one.ends - now)}", RENEW
        )


ROBOT_LINK = Examination("robot", _link, _link_seen)
WATCHDOG = Examination("watchdog", _watchdog, _watchdog_seen)
ODOMETRY = Examination("odometry", _odometry, _odometry_seen)
CLOCKS = Examination("clock", _clocks, _clocks_seen)
CERTIFICATES = Examination("certificate", _certificate, _certificate_seen)
