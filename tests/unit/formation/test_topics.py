from __future__ import annotations

from pathlib import Path

import pytest

from formation.topics import (
    CMD_VEL,
    ERROR,
    ORDER,
    POSITION,
    RELATIVE,
    TABLE,
    WATCHDOG,
    command_topic,
)

ROOT = Path(__file__).parents[3]


def test_topic_names_and_keys_are_unique() -> None:
    assert len({topic.name for topic in TABLE}) == len(TABLE)
    assert len({topic.pattern for topic in TABLE}) == len(TABLE)


@pytest.mark.parametrize("robot", ["", "robot 2", "robot/2", "*", "r$", "r?", "r#", "{robot}"])
def test_robot_name_illegal_in_keys_is_refused(robot: str) -> None:
    with pytest.raises(ValueError, match="robot"):
        POSITION.key(robot)


def test_key_with_extra_or_missing_name_is_refused() -> None:
    with pytest.raises(ValueError, match="robot is 'robot2'"):
        ERROR.key("robot2")
    with pytest.raises(ValueError, match="other is ''"):
        RELATIVE.key("robot2")


def test_both_command_types_use_the_same_key() -> None:
    assert command_topic("twist").type == "geometry_msgs/msg/Twist"
    stamped = command_topic("twist_stamped")
    assert stamped.types == ("geometry_msgs/msg/TwistStamped",)
    assert stamped.key("robot2") == CMD_VEL.key("robot2")


def test_only_orders_and_watchdogs_are_queried() -> None:
    assert [topic for topic in TABLE if topic.qos is None] == [ORDER, WATCHDOG]
    assert [topic for topic in TABLE if not topic.types] == [ORDER, WATCHDOG]


def test_only_topics_module_spells_keys() -> None:
    words = [topic.pattern.rpartition("/")[2] for topic in TABLE if "{other}" not in topic.pattern]
    spelled = [f"/{word}{quote}" for word in words for quote in "\"'"]
    packages = ("formation", "agent", "leader", "monitor", "deploy")
    sources = [path for package in packages for path in (ROOT / package).rglob("*.py")]
    assert len(sources) > 20
    for path in sources:
        if path.name != "topics.py":
            text = path.read_text().replace('"/api/', '"')  # paths of the live page are no keys
            assert [key for key in spelled if key in text] == [], path
