"""A leader driven by hand: velocities and their expiry, limits and bounds."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.leader.core import Leader
from formation.leader.driving import ramped
from formation.leader.relays import Relays
from formation.mission.file import parse, read
from formation.mission.route import Waypoints
from formation.protocol import json_message
from formation.protocol.order import DRIVE_TIMEOUT_SECONDS
from formation.protocol.reasons import Code, Reason
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.slots.geofence import Geofence
from formation.stability.driving import STANDS, Limits, Velocity, first_limits, followable
from tests.support.fleet import at
from tests.unit.leader.leading import ask, drive, leading, listens, positions

TEXT = read("convoy")[0].replace('robots = ["robot1"]', 'robots = ["robot3"]', 1)
"""A mission with a leader that waits for a robot that it never receives."""
CONVOY = parse(TEXT)
speeds = st.floats(-10.0, 10.0)


class Driver:
    """A driver that sends a velocity every 50 ms with the newest token."""

    def __init__(self, leader: Leader, name: str = "driver-1") -> None:
        self.leader, self.name, self.token = leader, name, 0

    def send(self, now: float, forward: float, turn_rate: float = 0.0) -> OperatorReply:
        request = OperatorRequest(
            do="drive", forward=forward, turn_rate=turn_rate, token=self.token, id=self.name
        )
        reply = json_message.decode(OperatorReply, self.leader.request(json_message.encode(request), now))
        self.token = reply.token or self.token
        return reply

    def hold_stick(self, since: float, seconds: float, forward: float, turn_rate: float = 0.0) -> float:
        """Send a velocity for `seconds`; return the time of the last request."""
        for i in range(round(seconds / 0.05) + 1):
            now = since + 0.05 * i
            self.send(now, forward, turn_rate)
            self.leader.step(at(now + 1e-4), [])
        return now


def driven(
    seconds: float = 2.0, forward: float = 0.1, turn_rate: float = 0.0
) -> tuple[Leader, Driver, float]:
    leader = leading(CONVOY)
    driver = Driver(leader)
    return leader, driver, driver.hold_stick(0.1, seconds, forward, turn_rate)


def test_leader_drives_while_velocities_arrive() -> None:
    leader, _, _ = driven()
    assert leader.mode == "run"
    assert leader.plan.route.id == "driven"
    assert 0.1 * (2.0 - 0.6) < leader.plan.where().real <= 0.1 * 2.0
    assert leader.plan.where().imag == 0.0


def test_first_request_moves_nothing() -> None:
    leader = leading(CONVOY)
    assert not Driver(leader).send(0.1, 0.1).ok
    drive(leader, 0.15, 0.5)
    assert leader.plan.where() == 0j


@pytest.mark.parametrize("rest", ["hold", "stop"])
def test_stick_held_through_a_hold_moves_nothing_until_released(rest: str) -> None:
    leader, driver, end = driven()
    ask(leader, rest, end)
    end = driver.hold_stick(end + 0.05, 1.0, 0.1)
    if rest == "stop":
        ask(leader, "release", end)
    ask(leader, "run", end)
    place = leader.plan.where()
    end = driver.hold_stick(end + 0.05, 1.0, 0.1)
    assert leader.plan.where() == place
    end = driver.hold_stick(end + 0.05, 0.1, 0.0)
    driver.hold_stick(end + 0.05, 1.0, 0.1)
    assert leader.plan.where() != place


def test_zero_velocity_holds_the_team_at_once() -> None:
    leader, driver, end = driven()
    driver.send(end + 0.05, 0.0)
    (now,) = positions(end, leader.step(at(end + 0.051), []))
    assert now.order.mode == "hold"


def test_team_holds_after_drive_timeout() -> None:
    leader, _, end = driven()
    sent = drive(leader, end + 0.01, 1.0, step=0.01)
    late = [one for one in sent if one.mono > end + DRIVE_TIMEOUT_SECONDS + 0.011]
    assert late
    assert {one.order.mode for one in late} == {"hold"}
    assert len({one.pose.position for one in late}) == 1


@pytest.mark.parametrize("delay", [0.31, 1.0, 3600.0])
def test_late_or_recorded_velocity_moves_nothing(delay: float) -> None:
    leader, driver, end = driven()
    request = OperatorRequest(do="drive", forward=0.1, turn_rate=0.0, token=driver.token, id=driver.name)
    drive(leader, end + 0.01, min(delay, 2.0))
    place = leader.plan.where()
    reply = json_message.decode(OperatorReply, leader.request(json_message.encode(request), end + delay))
    assert not reply.ok
    assert "too late" in reply.reason
    leader.step(at(end + delay + 0.001), [])
    assert leader.plan.where() == place
    assert leader.mode == "hold"


@given(st.lists(st.integers(0, 40), max_size=60))
def test_repeated_request_does_not_prolong_a_velocity(moments: list[int]) -> None:
    """Whenever the last request is repeated, the leader holds 0.3 s after the reply with its token."""
    leader, driver, end = driven(0.3)
    request = OperatorRequest(do="drive", forward=0.1, turn_rate=0.0, token=driver.token, id=driver.name)
    for moment in sorted(moments):
        now = end + 0.05 * moment
        leader.request(json_message.encode(request), now)
        leader.step(at(now + 1e-4), [])
        if now > end + DRIVE_TIMEOUT_SECONDS:
            assert leader.mode == "hold"


def test_second_driver_is_refused_while_the_first_drives() -> None:
    leader, driver, end = driven()
    other = Driver(leader, "driver-2")
    other.send(end, 0.2)
    assert other.send(end + 0.01, 0.2).reason == "driver-1 drives"
    assert driver.send(end + 0.02, 0.1).ok
    drive(leader, end + 0.03, 0.5)
    other.send(end + 0.55, 0.2)
    assert "let go" in other.send(end + 0.56, 0.2).reason
    assert other.send(end + 0.57, 0.0).ok
    assert other.send(end + 0.58, 0.2).ok


def test_driver_that_waited_with_a_held_stick_does_not_drive_on() -> None:
    leader, driver, end = driven()
    other = Driver(leader, "driver-2")
    other.send(end, 0.2)
    for i in range(1, 4):
        driver.send(end + 0.05 * i, 0.0)
        assert not other.send(end + 0.05 * i, 0.2).ok
        leader.step(at(end + 0.05 * i + 1e-4), [])
    place = leader.plan.where()
    end = other.hold_stick(end + 0.2, 3.0, 0.2)
    assert leader.plan.where() == place
    end = other.hold_stick(end + 0.05, 0.1, 0.0)
    other.hold_stick(end + 0.05, 0.5, 0.2)
    assert leader.plan.where() != place


def test_idle_driver_keeps_out_no_driver_that_begins_from_zero() -> None:
    leader, driver, end = driven()
    other, answers = Driver(leader, "driver-2"), {}
    for now, forward in [*((end + 0.1 * i, 0.1) for i in range(1, 20)), (end + 2.0, 0.0), (end + 2.1, 0.1)]:
        last = driver.send(now, 0.0)
        answers[now] = other.send(now + 0.01, forward)
    assert [answer.ok for answer in answers.values()] == [False] * 19 + [True] * 2
    assert last.ok
    assert driver.send(end + 2.2, 0.0).reason == "driver-2 drives"


def test_driver_without_an_id_is_refused() -> None:
    leader = leading(CONVOY)
    driver = Driver(leader, "")
    driver.send(0.1, 0.1)
    assert "id" in driver.send(0.15, 0.1).reason
    assert leader.plan.route.id != "driven"


def test_velocity_is_refused_during_hold_and_stop() -> None:
    leader, driver, end = driven()
    for do in ("hold", "stop"):
        leader.request(json_message.encode(OperatorRequest(do=do, id=do)), end + 0.01)
        assert not driver.send(end + 0.02, 0.1).ok
        leader.step(at(end + 0.03), [])
        assert leader.mode == do


def test_ordered_route_ends_the_drive() -> None:
    leader, _, end = driven()
    speed = OperatorRequest(do="speed", speed=0.05, degrees=0.0, id="s")
    leader.request(json_message.encode(speed), end + 0.01)
    drive(leader, end + 0.02, 2.0)
    assert leader.mode == "run"
    assert leader.plan.route.id != "driven"


def order_speed(leader: Leader, now: float, name: str = "s") -> None:
    request = OperatorRequest(do="speed", speed=0.0, degrees=0.0, id=name)
    assert json_message.decode(OperatorReply, leader.request(json_message.encode(request), now)).ok


def test_second_order_gives_held_stick_nothing_back() -> None:
    leader, driver, end = driven()
    order_speed(leader, end + 0.01)
    end = driver.hold_stick(end + 0.05, 0.5, 0.1)
    order_speed(leader, end + 0.01, "again")
    driver.hold_stick(end + 0.05, 0.5, 0.1)
    assert leader.plan.route.id != "driven"


def test_late_copy_of_first_request_gives_held_stick_nothing_back() -> None:
    leader, driver, end = driven()
    order_speed(leader, end + 0.01)
    newest, driver.token = driver.token, 0
    driver.send(end + 0.02, 0.1)
    driver.token = newest
    driver.hold_stick(end + 0.05, 0.5, 0.1)
    assert leader.plan.route.id != "driven"


@pytest.mark.parametrize("held", [0.0, 0.1])
def test_driver_must_let_go_and_drive_again_after_ordered_route(held: float) -> None:
    leader, driver, end = driven()
    driver.send(end + 0.01, held)
    leader.request(
        json_message.encode(OperatorRequest(do="speed", speed=0.05, degrees=0.0, id="s")), end + 0.02
    )
    end = driver.hold_stick(end + 0.05, 1.0, held)
    assert leader.mode == "run"
    assert leader.plan.route.id != "driven"
    assert "let go" in driver.send(end + 0.05, held).reason
    end = driver.hold_stick(end + 0.1, 0.5, 0.0)
    assert leader.mode == "run"
    driver.hold_stick(end + 0.05, 0.2, 0.1)
    assert (leader.mode, leader.plan.route.id) == ("run", "driven")


def test_repeated_path_does_not_end_drive() -> None:
    leader, driver, end = driven()
    path = OperatorRequest(do="route", legs=(Waypoints(waypoints=((3.0, 0.0),), speed=0.1),), joins=True)

    def send_path(now: float) -> OperatorReply:
        aged = path.model_copy(update={"id": f"path-{now}"})
        return json_message.decode(OperatorReply, leader.request(json_message.encode(aged), now))

    reply = send_path(end + 0.01)
    assert (reply.ok, reply.code) == (False, "driven")
    assert "driver-1 drives by hand" in reply.reason
    end = driver.hold_stick(end + 0.05, 0.5, 0.1)
    assert (leader.mode, leader.plan.route.id) == ("run", "driven")
    end = driver.hold_stick(end + 0.05, 0.8, 0.0)
    assert not send_path(end + 0.01).ok
    end = driver.hold_stick(end + 0.05, 0.3, 0.0)
    assert send_path(end + 0.01).ok
    end = driver.hold_stick(end + 0.05, 0.5, 0.0)
    assert leader.plan.route.id != "driven"
    driver.hold_stick(end + 0.05, 0.5, -0.1)
    assert leader.plan.route.id == "driven"


def test_driver_that_had_let_go_drives_on_after_ordered_route() -> None:
    leader, driver, end = driven()
    driver.send(end + 0.01, 0.0)
    leader.request(
        json_message.encode(OperatorRequest(do="speed", speed=0.05, degrees=0.0, id="s")), end + 0.02
    )
    driver.hold_stick(end + 5.0, 0.2, 0.1)
    assert (leader.mode, leader.plan.route.id) == ("run", "driven")


def test_new_driver_takes_leader_from_ordered_route() -> None:
    leader, _, end = driven()
    leader.request(
        json_message.encode(OperatorRequest(do="speed", speed=0.05, degrees=0.0, id="s")), end + 0.02
    )
    Driver(leader, "driver-2").hold_stick(end + 0.5, 0.2, 0.0)
    assert (leader.mode, leader.plan.route.id) == ("hold", "driven")


def test_idle_driver_leaves_ordered_route_after_takeover() -> None:
    leader, driver, end = driven()
    leader.request(
        json_message.encode(OperatorRequest(do="speed", speed=0.05, degrees=0.0, id="s")), end + 0.02
    )
    other = leading(CONVOY)
    other.plan.add_route(leader.plan.route)
    other.plan.restore(leader.plan.order(1, 5, "run"))
    driver.leader = other
    driver.hold_stick(end + 0.05, 0.5, 0.0)
    assert (other.mode, other.plan.route.id) == ("run", leader.plan.route.id)


def test_standby_holds_after_takeover_of_a_drive() -> None:
    leader, _, _ = driven()
    newest = leader.plan.order(1, 5, "run")
    other = leading(CONVOY)
    other.plan.restore(newest)
    assert abs(other.plan.where() - leader.plan.where()) < 1e-3
    assert {one.order.mode for one in drive(other, 0.2, 0.5)} == {"hold"}
    Driver(other).hold_stick(0.7, 0.5, 0.1)
    assert other.mode == "run"


def test_held_stick_moves_next_leader_only_after_release() -> None:
    leader, driver, end = driven()
    driver.leader = other = leading(CONVOY)
    other.plan.restore(leader.plan.order(1, 5, "run"))
    place = other.plan.where()
    end = driver.hold_stick(end + 0.05, 1.0, 0.1)
    assert other.plan.where() == place
    end = driver.hold_stick(end + 0.05, 0.1, 0.0)
    driver.hold_stick(end + 0.05, 0.5, 0.1)
    assert other.plan.where() != place


def test_leader_stops_at_the_bounds() -> None:
    leader = leading(CONVOY.changed(bounds=None))
    driver = Driver(leader)
    driver.hold_stick(0.1, 200.0, 0.2)
    assert leader.plan.fenced is not None
    place = leader.plan.where()
    assert place.real < 29.7
    driver.hold_stick(200.2, 5.0, -0.2)
    assert leader.plan.where().real < place.real


@given(speeds, speeds)
def test_followable_velocity_is_within_limits(forward: float, turn_rate: float) -> None:
    within = first_limits(CONVOY)
    found = followable(Velocity(forward, turn_rate), within)
    assert abs(found.forward) <= within.speed < 0.2108
    assert abs(found.turn_rate) <= within.turn_rate
    assert found.forward == 0.0 or abs(found.turn_rate) * within.radius <= abs(found.forward) + 1e-12
    assert abs(found.forward) + abs(found.turn_rate) * within.swing <= within.top_speed


@given(speeds, speeds, st.floats(0.0, 1.0))
def test_ramp_goes_towards_the_wanted_velocity(forward: float, turn_rate: float, dt: float) -> None:
    within = Limits(speed=1.0, turn_rate=2.0, radius=0.1, swing=0.0, top_speed=1.0)
    found = ramped(STANDS, Velocity(forward, turn_rate), within, dt)
    assert abs(found.forward) <= min(abs(forward), 2.0 * dt * within.speed) + 1e-12
    assert math.copysign(1.0, found.forward) == math.copysign(1.0, forward) or found.forward == 0.0


def test_token_is_the_leaders_clock_in_milliseconds() -> None:
    assert leading(CONVOY).plan.driver.token(12.3456) == 12345


def test_token_of_another_process_moves_nothing() -> None:
    """Whatever the clocks of both say: those of two machines, or before and after a reboot."""
    _, driver, end = driven()
    other = Leader(CONVOY, publisher_id="another")
    listens(other)
    drive(other, 0.04, end)
    driver.leader = other
    assert "too late" in driver.send(end + 0.05, 0.1).reason
    assert other.plan.route.id != "driven"
    assert "let go" in driver.send(end + 0.1, 0.1).reason
    assert driver.send(end + 0.15, 0.0).ok
    assert driver.send(end + 0.2, 0.1).ok


def test_order_of_driven_leader_counts_on_under_the_next() -> None:
    """Robots that join tell by it whether their fleet still faces as at its start."""
    leader, _, _ = driven()
    order = leader.plan.order(1, 1, "run")
    assert order.driven
    assert order.time > 1.0
    other = Leader(CONVOY, publisher_id="another")
    other.plan.restore(order)
    assert other.plan.order(2, 1, "run").time == order.time


def test_turning_leader_keeps_slots_within_the_bounds() -> None:
    mission = parse(TEXT + "\n[bounds]\nx = [-2.6, 6.0]\ny = [-1.2, 1.2]\n")
    leader = leading(mission)
    driver, fence = Driver(leader), Geofence(mission)
    now = driver.hold_stick(0.1, 15.0, 0.12)
    for turn_rate in (0.3, -0.3):
        for _ in range(300):
            now += 0.05
            driver.send(now, 0.0, turn_rate)
            for one in positions(now, leader.step(at(now + 1e-4), [])):
                fence.check(one.order)  # raises BadMessage
        assert leader.plan.fenced is not None
        assert turn_rate * cmath.phase(leader.plan.route.heading(leader.plan.route_time)) > 0.05


def test_velocity_sent_before_the_zero_velocity_is_refused() -> None:
    leader, driver, end = driven()
    late = driver.token
    driver.send(end + 0.05, 0.0)
    leader.step(at(end + 0.051), [])
    driver.token = late
    assert not driver.send(end + 0.06, 0.1).ok
    (now,) = positions(end, leader.step(at(end + 0.1), []))
    assert now.order.mode == "hold"
    assert driver.send(end + 0.15, 0.1).ok


def test_run_without_a_driver_says_why_nothing_moves() -> None:
    leader, driver, end = driven()
    assert ask(leader, "run", end).reason == ""
    drive(leader, end + 0.01, 1.0)
    reply = ask(leader, "run", end + 1.0)
    assert reply.ok
    assert "formation drive, or order a speed or a route" in reply.reason
    driver.hold_stick(end + 1.05, 0.5, 0.1)
    assert leader.mode == "run"


def test_refused_first_request_does_not_clear_route_unknown() -> None:
    leader = leading(CONVOY)
    leader.plan.team_mode.lost = Reason(Code.ROUTE_UNKNOWN)
    driver = Driver(leader)
    assert driver.send(0.1, 0.1).code == "first"
    assert leader.plan.team_mode.lost is not None
    assert "order run" in driver.send(0.15, 0.1).reason
    assert leader.plan.team_mode.lost is None


def test_constant_delay_of_relayed_orders_is_named() -> None:
    relays = Relays()
    for beat in range(1, 100):
        sent = 0.05 * beat
        relays.receive("robot2", beat, sent, sent + 0.4)
        relays.receive("robot3", beat, sent, sent + 1.6)
        named = sent + 1.6 >= 0.05 + 1.6 + 1.0 - 1e-9
        assert relays.late(sent + 1.6).startswith("robot3 relays its orders 1.6 s old; limit 1.5 s") is named
    relays.receive("robot3", 100, 5.0, 6.65)
    assert relays.late(6.7)
    relays.receive("robot3", 101, 5.05, 6.4)  # within the limit
    assert relays.late(6.7) == ""


def test_relayed_beat_that_no_longer_rises_is_ignored() -> None:
    relays = Relays()
    for beat in range(1, 50):
        relays.receive("robot3", beat, 0.05 * beat, 0.05 * beat + 2.0)
    assert relays.late(4.5)
    for number in range(100):
        relays.receive("robot3", 49, 2.45, 4.5 + 0.05 * number)
    assert relays.late(6.0) == ""
    relays.begin()
    relays.receive("robot3", 1, 9.0, 9.1)
    assert relays.late(9.2) == ""
