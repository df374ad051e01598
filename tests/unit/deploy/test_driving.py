"""`formation drive`: keys, gamepads, topics, and the requests of a driver."""

from __future__ import annotations

import math
import os
import struct
from argparse import Namespace
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from formation.deploy.driving import drive
from formation.deploy.driving.inputs import (
    AXIS,
    BUTTON,
    DEAD_MAN_BUTTON,
    EVENT,
    FIRST_KEY_SECONDS,
    FORWARD_AXIS,
    INITIAL,
    KEY_SECONDS,
    RELEASED,
    TWIST_SECONDS,
    Gamepad,
    Keys,
    Share,
    Twists,
)
from formation.deploy.driving.remote import Remote
from formation.deploy.refusal import Refusal
from formation.mission.file import load
from formation.protocol import json_message
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.ros2.messages import Twist, TwistStamped, encode
from formation.transport.runtime import clock
from formation.wire import Sample

PATROL = load("patrol")


def test_key_press_expires_after_first_key_seconds() -> None:
    keys = Keys()
    keys.press("i", 1.0)
    assert keys.velocity(1.0 + 0.9 * FIRST_KEY_SECONDS) == Share(1.0, 0.0)
    assert keys.velocity(1.0 + FIRST_KEY_SECONDS) == RELEASED


def test_held_key_ends_soon_after_release() -> None:
    keys = Keys()
    for press in range(40):
        keys.press("u", 1.0 + 0.03 * press)
    assert keys.velocity(2.2) == Share(1.0, 1.0)
    assert keys.velocity(2.17 + KEY_SECONDS + 0.01) == RELEASED


@pytest.mark.parametrize("key", [" ", "k", "x", "q", "\x03"])
def test_other_key_stops_and_q_or_ctrl_c_quits(key: str) -> None:
    keys = Keys()
    keys.press("i", 1.0)
    keys.press(key, 1.1)
    assert keys.velocity(1.1) == RELEASED
    assert keys.quits == (key in "q\x03")


@pytest.mark.parametrize(
    "sequence", ["\x1b[<0;33;12m", "\x1b[M iu", "\x1b[120u", "\x1b[27;2;105~", "\x1bOm", "\x1b[1;2A"]
)
def test_terminal_sequence_is_no_key(sequence: str) -> None:
    """Mouse reports and keys in other encodings, as after a program that left the terminal so."""
    keys = Keys()
    keys.press("i", 1.0)
    keys.press(3 * sequence, 1.1)
    assert keys.velocity(1.1) == RELEASED
    assert not keys.quits


def test_last_of_two_arrows_in_one_read_counts() -> None:
    keys = Keys()
    keys.press("\x1b[A\x1b[D", 1.0)
    assert keys.velocity(1.0) == Share(0.0, 1.0)


def event(kind: int, number: int, value: int) -> bytes:
    return EVENT.pack(0, value, kind, number)


def test_stick_counts_only_while_dead_man_button_is_held() -> None:
    gamepad = Gamepad()
    gamepad.events(event(AXIS, FORWARD_AXIS, -32767))
    for pressed, velocity in ((0, RELEASED), (1, Share(1.0, 0.0)), (0, RELEASED)):
        gamepad.events(event(BUTTON, DEAD_MAN_BUTTON, pressed))
        assert gamepad.velocity(0.0) == velocity


def test_button_held_at_start_must_be_pressed_again() -> None:
    gamepad = Gamepad()
    gamepad.events(event(BUTTON | INITIAL, DEAD_MAN_BUTTON, 1) + event(AXIS | INITIAL, FORWARD_AXIS, -32767))
    assert gamepad.velocity(0.0) == RELEASED


def test_unplugged_gamepad_gives_velocity_none() -> None:
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    gamepad = Gamepad()
    with os.fdopen(reading):
        os.write(writing, event(BUTTON, DEAD_MAN_BUTTON, 1) + event(AXIS, FORWARD_AXIS, -32767))
        gamepad.read(reading)
        assert gamepad.velocity(0.0) == Share(1.0, 0.0)
        os.close(writing)
        gamepad.read(reading)
        assert gamepad.velocity(0.0) is None


def test_keys_buffered_for_seconds_are_ignored(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    master, slave = os.openpty()
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        times = iter((0.0, 0.05, 3.0, 3.05))
        monkeypatch.setattr(drive, "monotonic", times.__next__)
        with drive._keys() as read:
            assert read() == RELEASED
            os.write(master, b"i")
            assert read() == RELEASED  # 2.95 s later
            os.write(master, b"i")
            assert read() == Share(1.0, 0.0)
    os.close(master)
    assert "i  o      forward and left, forward" in capsys.readouterr().err  # printed before the first key


@pytest.mark.parametrize(
    ("length", "expected"),
    [(0, "\r\x1b[J"), (40, "\r\x1b[J"), (41, "\r\x1b[1A\x1b[J"), (121, "\r\x1b[3A\x1b[J")],
)
def test_wrapped_line_is_erased_whole(length: int, expected: str) -> None:
    assert drive.erased("x" * length, 40) == expected


def test_twist_is_limited_and_expires_after_twist_seconds() -> None:
    twists = Twists(0.2, 1.0)
    twists.add(0.1, -5.0, 1.0)
    assert twists.velocity(1.0) == Share(0.5, -1.0)
    assert twists.velocity(1.0 + TWIST_SECONDS) == RELEASED


@pytest.mark.parametrize("tiny", [5e-324, -1e-9, 1e-4])
def test_tiny_twist_lets_go(tiny: float) -> None:
    """The leader would run, and robots close their errors, though the driver wants to stand."""
    twists = Twists(0.2, 1.0)
    twists.add(tiny, -tiny, 1.0)
    assert twists.velocity(1.1) == RELEASED


def test_twist_expires_after_the_machine_was_suspended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "_SUSPENDED", clock._SUSPENDED - 3600.0)  # for an hour, since the start
    samples = [
        Sample("cmd_vel", encode(Twist(0.1, 0.0)), None, clock.monotonic() - age)
        for age in (0.0, TWIST_SECONDS)
    ]
    bus = SimpleNamespace(drain=lambda: [samples.pop(0)])
    monkeypatch.setattr(drive, "listening", lambda *_: nullcontext(bus))
    options = Namespace(ros="", topic="/cmd_vel", domain=0)
    with drive._topic(options, Twists(0.2, 1.0)) as read:
        assert read() == Share(0.5, 0.0)
        assert read() == RELEASED


@pytest.mark.parametrize("frame", ["", "base_link"])
def test_stamped_twist_counts_as_twist(monkeypatch: pytest.MonkeyPatch, frame: str) -> None:
    """TurtleBot3's teleop_keyboard sends it with Jazzy; a wrong clock of its computer does not matter."""
    stamped = encode(TwistStamped(1e9, 0.1, -0.5, frame))
    sample = Sample("cmd_vel", stamped, None, clock.monotonic())
    monkeypatch.setattr(drive, "listening", lambda *_: nullcontext(SimpleNamespace(drain=lambda: [sample])))
    with drive._topic(Namespace(ros="", topic="/cmd_vel", domain=0), Twists(0.2, 1.0)) as read:
        assert read() == Share(0.5, -0.5)


@pytest.mark.parametrize("speed", [math.nan, math.inf])
def test_twist_without_finite_speed_ends_the_drive(monkeypatch: pytest.MonkeyPatch, speed: float) -> None:
    payload = encode(Twist(0.125, 0.0)).replace(struct.pack("<d", 0.125), struct.pack("<d", speed))
    sample = Sample("cmd_vel", payload, None, clock.monotonic())
    monkeypatch.setattr(drive, "listening", lambda *_: nullcontext(SimpleNamespace(drain=lambda: [sample])))
    options = Namespace(ros="", topic="/cmd_vel", domain=0)
    with (
        drive._topic(options, Twists(0.2, 1.0)) as read,
        pytest.raises(drive.Ended, match=f"cmd_vel: .*speed is {speed}") as ended,
    ):
        read()
    assert ended.value.code == 1


@given(
    st.floats(-1.0, 1.0),
    st.floats(-1.0, 1.0),
    st.floats(5.0, 100.0),
    st.floats(5.0, 100.0),
    st.floats(0.0, 0.2),
)
def test_two_contradicting_publishers_are_noticed_within_three_seconds(
    first: float, second: float, rate: float, other_rate: float, late: float
) -> None:
    assume(abs(first - second) > 0.11)
    samples = [(number / rate, first) for number in range(int(3 * rate))]
    samples += [(late + number / other_rate, second) for number in range(int(3 * other_rate))]
    twists, noticed = Twists(0.2, 1.0), False
    for arrived, share in sorted(samples):
        twists.add(0.2 * share, 0.0, arrived)
        noticed |= twists.contradict
    assert noticed


@given(st.floats(0.5, 3.0), st.floats(0.1, 1.0), st.floats(5.0, 100.0), st.booleans())
def test_quick_hand_contradicts_nobody(frequency: float, size: float, rate: float, switches: bool) -> None:
    """A stick that goes to and fro up to three times a second, or a key pressed as often."""
    twists = Twists(0.2, 1.0)
    for number in range(int(5 * rate)):
        wave = math.sin(math.tau * frequency * number / rate)
        twists.add(0.2 * size * ((wave > 0.0) if switches else wave), 0.0, number / rate)
        assert not twists.contradict


def test_contradicting_publishers_end_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = [
        Sample("cmd_vel", encode(Twist(speed, 0.0)), None, clock.monotonic()) for speed in (0.1, 0.0) * 6
    ]
    monkeypatch.setattr(drive, "listening", lambda *_: nullcontext(SimpleNamespace(drain=lambda: samples)))
    with (
        drive._topic(Namespace(ros="", topic="/cmd_vel", domain=0), Twists(0.2, 1.0)) as read,
        pytest.raises(drive.Ended, match="cmd_vel: commands change back and forth") as ended,
    ):
        read()
    assert ended.value.code == 1


def replied(robot: str, token: int, *, leads: bool = True, reason: str = "") -> bytes:
    return json_message.encode(
        OperatorReply(robot=robot, ok=not reason, mode="run", reason=reason, leads=leads, token=token)
    )


def test_driver_asks_all_candidates_until_one_leads() -> None:
    remote = Remote(PATROL, "driver-1")
    keys, _ = remote.request(0.1, 0.0, 1.0)
    assert keys == ("leader/order", "deputy/order", "reserve/order")
    replies = [replied("deputy", 7), replied("leader", 0, leads=False, reason="stands by")]
    remote.process_replies(replies, 1.0, 1.01)
    keys, payload = remote.request(0.1, 0.0, 1.05)
    assert keys == ("deputy/order",)
    assert json_message.decode(OperatorRequest, payload).token == 7
    assert remote.request(0.1, 0.0, 2.0)[0] == ("leader/order", "deputy/order", "reserve/order")


def test_driver_accepts_smaller_token_only_from_another_process() -> None:
    remote = Remote(PATROL, "driver-1")
    remote.process_replies([replied("leader", 900)], 1.0, 1.01)
    for replies, token in (
        ([replied("leader", 800), b"{"], 900),
        ([replied("leader", 500)], 500),  # it was restarted
        ([replied("deputy", 350)], 350),
    ):
        remote.process_replies(replies, 1.0, 1.01)
        assert json_message.decode(OperatorRequest, remote.request(0.0, 0.0, 1.02)[1]).token == token


def test_reply_without_token_does_not_let_driver_begin_again() -> None:
    remote = Remote(PATROL, "driver-1")
    remote.process_replies(
        [replied("leader", 900), replied("leader", 0, reason="another mission")], 1.0, 1.01
    )
    assert json_message.decode(OperatorRequest, remote.request(0.1, 0.0, 1.02)[1]).token == 900


def test_state_names_reason_of_leader_refusal() -> None:
    remote = Remote(PATROL, "driver-1")
    assert remote.state.words(1.0) == "no leader answers"
    remote.process_replies([replied("leader", 1, reason="held: order run first")], 1.0, 1.01)
    assert remote.state.words(1.02) == "leader does not obey: held: order run first"


@pytest.mark.parametrize(
    ("replies", "says"),
    [
        ([], "no leader of patrol has answered"),
        ([{"ok": True}], "all robots hold"),
        ([{"ok": False, "code": "first", "reason": "a token"}], "all robots hold"),
        ([{"ok": False, "reason": "another drives"}], "leader did not obey: another drives"),
    ],
)
def test_end_of_drive_says_hold_only_if_the_leader_obeys(replies: list[dict[str, Any]], says: str) -> None:
    one = drive._Drive(SimpleNamespace(), PATROL, 0.2, 1.0)  # type: ignore[arg-type]
    for reply in replies:
        data = json_message.encode(OperatorReply(robot="leader", mode="run", leads=True, token=1, **reply))
        one._remote.process_replies([data], clock.monotonic(), clock.monotonic())
    assert one.outcome.startswith(says)


def test_end_of_drive_claims_no_hold_without_recent_answer() -> None:
    """After 1 s without a velocity the leader obeys a planner that follows ROS."""
    one = drive._Drive(SimpleNamespace(), PATROL, 0.2, 1.0)  # type: ignore[arg-type]
    one._remote.process_replies([replied("leader", 1)], clock.monotonic(), clock.monotonic() - 5.0)
    assert one.outcome.startswith("leader has not answered for 5.0 s, so what the robots do is not known")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--speed 99", "--speed 99 m/s: must be at most "),
        ("--turn-rate 99", "--turn-rate 99 rad/s: must be at most "),
        ("--gamepad --domain 3", "with --topic only"),
        ("--ros tcp/127.0.0.1:7450", "with --topic only"),
    ],
)
def test_flags_without_effect_and_excessive_limits_are_refused(arguments: str, message: str) -> None:
    with pytest.raises(Refusal, match=message):
        drive.main(["convoy", *arguments.split()])


def test_invalid_domain_in_the_environment_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(Refusal, match="ROS_DOMAIN_ID 'many': must be a ROS domain"):
        drive.main(["convoy", "--topic", "/cmd_vel"])
