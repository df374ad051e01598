"""The topics that `formation drive` and `formation follow` receive from a bridge or from rmw_zenoh."""

from __future__ import annotations

import time

from formation.deploy.driving.ros import MAX_WAITING, listening
from formation.ros2.messages import Twist, encode
from formation.topics import command_topic
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig

TYPE = "geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported"


def test_listening_receives_only_its_topic_and_domain(endpoint: str) -> None:
    keys = {"cmd_vel": 0.1, f"7/cmd_vel/{TYPE}": 0.2, f"8/cmd_vel/{TYPE}": 0.3, "robot1/cmd_vel": 0.4}
    keys |= {f"7/cmd_vel/raw/{TYPE}": 0.6}  # the topic /cmd_vel/raw
    with Bus(BusConfig(listen=(endpoint,), mode="router", name="bridge")) as bridge:
        for key in keys:
            bridge.advertise(command_topic("twist"), key)
        with listening(endpoint, 7, ("/cmd_vel",)) as bus:
            wanted = {encode(Twist(speed, 0.0)) for speed in (0.1, 0.2, 0.5)}
            received: set[bytes] = set()
            deadline = time.monotonic() + 20.0
            while not wanted <= received:  # 0.5 is published after the unwanted messages of its round
                assert time.monotonic() < deadline
                for key, speed in keys.items():
                    bridge.publish(key, encode(Twist(speed, 0.0)))
                bridge.publish("cmd_vel", encode(Twist(0.5, 0.0)))
                time.sleep(0.05)
                received |= {sample.payload for sample in bus.drain()}
    assert received == wanted


def test_newest_of_many_waiting_messages_are_kept(endpoint: str) -> None:
    """A path may be large, and the leader's answer may take 3 s."""
    with Bus(BusConfig(listen=(endpoint,), mode="router", name="bridge")) as bridge:
        bridge.advertise(command_topic("twist"), "cmd_vel", waits=True)
        with listening(endpoint, 0, ("/cmd_vel",)) as bus:
            deadline, newest = time.monotonic() + 20.0, encode(Twist(0.9, 0.0))
            while not bridge.watched("cmd_vel"):
                assert time.monotonic() < deadline
                time.sleep(0.02)
            for number in range(2 * MAX_WAITING):
                bridge.publish("cmd_vel", encode(Twist(0.001 * number, 0.0)))
            bridge.publish("cmd_vel", newest)
            while bus.received["cmd_vel"] <= 2 * MAX_WAITING:
                assert time.monotonic() < deadline
                time.sleep(0.02)
            samples = bus.drain()
    assert len(samples) == MAX_WAITING
    assert samples[-1].payload == newest
