"""ROS names: logical keys, their spelling in both dialects, and back."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.file import MissionError, parse, read
from formation.mission.model import Mission
from formation.ros2.naming import Naming
from formation.ros2.ros_names import RosNames, address
from formation.ros2.tokens import Route, Token, dds_type, read_route, ros_type
from formation.ros2.tokens import read as read_token
from formation.topics import ERROR, ODOM, ORDER, TABLE
from tests.support.missions import edited

PAIR = read("turtlebot3_pair")[0]
SIX = read("six_robots")[0]
TWIST = "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
STAMPED = "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"


def pair(keys: str = "", robot1: str = "", robot2: str = "") -> Mission:
    """The TurtleBot mission with further keys for both robots, or for one."""
    text = edited(PAIR, "robot", keys)
    return parse(edited(edited(text, "robots.robot1", robot1), "robots.robot2", robot2))


def first(keys: str = "", robot1: str = "") -> Naming:
    """The names of robot1 in the mission of `pair`."""
    return Naming.of(pair(keys, robot1).robots, ["robot1"])


def test_ros2dds_keys_are_ros_names_without_slash() -> None:
    mission = pair()
    naming = Naming.of(mission.robots, mission.names)
    assert naming.wire("robot1/odom") == "robot1/odom"
    assert naming.wire("robot2/relative/leader") == "robot2/relative/leader"
    assert naming.wire(ERROR.key()) == "formation/error"
    assert naming.attachment("robot1/odom", 1, 0.0) is None
    assert naming.tokens("agent", ["robot1/cmd_vel"], ["robot1/odom"], "abc") == ()


def test_robot_without_namespace_has_bare_topics() -> None:
    assert first(robot1='namespace = ""').wire("robot1/odom") == "odom"


@pytest.mark.parametrize(
    ("kind", "name", "digest"), [("twist", "Twist", TWIST), ("twist_stamped", "TwistStamped", STAMPED)]
)
def test_rmw_zenoh_key_contains_domain_type_and_hash(kind: str, name: str, digest: str) -> None:
    naming = first(f'ros = "rmw_zenoh"\ndomain = 30\ncmd_vel = "{kind}"', 'namespace = "lab/burger_1"')
    spelled = f"30/lab/burger_1/cmd_vel/geometry_msgs::msg::dds_::{name}_/RIHS01_{digest}"
    assert naming.wire("robot1/cmd_vel") == spelled


def test_wrong_message_type_gives_another_key() -> None:
    naming = first('ros = "rmw_zenoh"')
    wrong = naming.wire("robot1/cmd_vel", "geometry_msgs/msg/Twist")
    assert wrong.endswith(f"Twist_/RIHS01_{TWIST}")
    assert wrong != naming.wire("robot1/cmd_vel")


def test_attachment_has_33_bytes_with_sequence_time_and_sender() -> None:
    naming = first('ros = "rmw_zenoh"')

    def parts(key: str, sequence: int, time: float, zid: str) -> tuple[int, int, int, bytes]:
        attachment = naming.attachment(key, sequence, time, zid)
        assert attachment is not None
        return struct.unpack("<qqB16s", attachment)  # 33 bytes

    *numbers, gid = parts("robot1/cmd_vel", 7, 1_763_687_000.25, "abc")
    assert numbers == [7, 1_763_687_000_250_000_000, 16]
    assert parts("robot1/cmd_vel", 8, 1_763_687_001.0, "abc")[3] == gid
    assert parts("robot1/cmd_vel", 7, 0.0, "def")[3] != gid
    assert parts("robot1/odom", 7, 0.0, "abc")[3] != gid


def test_tokens_show_node_publishers_and_subscribers() -> None:
    node, says, scan, receives = first('ros = "rmw_zenoh"\ndomain = 3').tokens(
        "formation_agent", ["robot1/cmd_vel"], ["robot1/scan", "robot1/odom"], "a1b2"
    )
    assert node == "@ros2_lv/3/a1b2/0/0/NN/%/%robot1/_formation_agent"
    assert says == (
        "@ros2_lv/3/a1b2/0/1/MP/%/%robot1/_formation_agent/%robot1%cmd_vel/"
        f"geometry_msgs::msg::dds_::TwistStamped_/RIHS01_{STAMPED}/::,10:,:,:,,"
    )
    sensed, received = read_token(scan), read_token(receives)
    assert sensed is not None
    assert received is not None
    assert (sensed.qos, received.qos) == ("2::,5:,:,:,,", "::,10:,:,:,,")
    assert (received.kind, received.id, received.topic, received.type) == ("MS", 3, "robot1/odom", ODOM.type)


def test_tokens_of_robots_have_own_nodes_and_ids() -> None:
    mission = pair('ros = "rmw_zenoh"', robot2='namespace = ""')
    naming = Naming.of(mission.robots, mission.followers)
    keys = [ODOM.key(name) for name in mission.followers]
    tokens = [read_token(token) for token in naming.tokens("robots", [*keys, ERROR.key()], (), "1")]
    shown = [(t.kind, t.node_id, t.id, t.namespace, t.topic) for t in tokens if t]
    assert shown == [
        ("NN", 0, 0, "robot1", ""),
        ("MP", 0, 1, "robot1", "robot1/odom"),
        ("NN", 2, 2, "", ""),
        ("MP", 2, 3, "", "odom"),
        ("NN", 4, 4, "", ""),
        ("MP", 4, 5, "", "formation/error"),
    ]


def test_formation_topics_follow_the_requested_dialect() -> None:
    assert Naming.of_formation().wire(ERROR.key()) == "formation/error"
    key = Naming.of_formation("rmw_zenoh", 5).wire(ERROR.key())
    assert key.startswith("5/formation/error/std_msgs::msg::dds_::Float64_/RIHS01_")


def test_robots_with_equal_ros_names_cannot_share_session() -> None:
    mission = pair('namespace = ""')
    with pytest.raises(ValueError, match=r"robot1/odom and robot2/odom cannot share .* both /odom"):
        Naming.of(mission.robots, mission.followers)
    assert Naming.of(mission.robots, ["robot2"]).wire("robot2/odom") == "odom"


def test_key_outside_topic_table_raises_error() -> None:
    with pytest.raises(ValueError, match="no key of the topic table"):
        first().wire("robot1/battery")
    with pytest.raises(KeyError):
        first().wire("robot2/odom")


NAMESPACES = st.one_of(
    st.none(),
    st.just(""),
    st.sampled_from(["robot2", "relative", "a/b", "a", "formation", "x/relative", "odom"]),
    st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,6}(/[A-Za-z_][A-Za-z0-9_]{0,6}){0,2}", fullmatch=True),
)


@given(
    namespaces=st.lists(NAMESPACES, min_size=6, max_size=6),
    dialects=st.lists(st.sampled_from(["ros2dds", "rmw_zenoh"]), min_size=6, max_size=6),
    domains=st.lists(st.sampled_from([0, 1, 232]), min_size=6, max_size=6),
)
def test_no_two_logical_keys_have_one_wire_key(
    namespaces: list[str | None], dialects: list[str], domains: list[int]
) -> None:
    text = SIX
    names = [f"robot{number}" for number in range(1, 7)]
    for name, namespace, dialect, domain in zip(names, namespaces, dialects, domains, strict=True):
        lines = f'ros = "{dialect}"\ndomain = {domain}\n'
        text = edited(
            text, f"robots.{name}", lines + (f'namespace = "{namespace}"\n' if namespace is not None else "")
        )
    mission = parse(text)  # legal: no two robots have an endpoint in common
    keys = [one.key for name in names for one in RosNames.of(name, mission.robots[name]).addresses()]
    keys.append(ERROR.key())
    for name in names:
        own = [key for key in keys if address(key).robot == name]
        assert_distinct(Naming.of(mission.robots, [name]), own)
    try:
        naming = Naming.of(mission.robots, names)
    except ValueError:
        return  # two robots share a name, so there is no naming
    assert_distinct(naming, keys)


def assert_distinct(naming: Naming, keys: list[str]) -> None:
    assert len({naming.wire(key) for key in keys}) == len(keys)


def test_ros_type_inverts_dds_type() -> None:
    types = {name for topic in TABLE for name in topic.types}
    assert dds_type("nav_msgs/msg/Odometry") == "nav_msgs::msg::dds_::Odometry_"
    assert {ros_type(dds_type(name)) for name in types} == types
    assert ros_type("HelloWorld::Msg") == dds_type("HelloWorld::Msg") == "HelloWorld::Msg"
    assert ORDER.type == ""
    for topic in TABLE:
        robot = "robot1" if "{robot}" in topic.pattern else ""
        other = "robot2" if "{other}" in topic.pattern else ""
        assert address(topic.key(robot, other)) == (topic, robot, other)


PARTS = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
PATHS = st.lists(PARTS, min_size=1, max_size=4).map("/".join)


@given(
    st.integers(0, 232), st.integers(0, 99), st.sampled_from(["NN", "MP", "MS", "SS", "SC"]),
    PATHS, PARTS, PATHS,
)  # fmt: skip
def test_read_token_inverts_token_key(
    domain: int, number: int, kind: str, namespace: str, node: str, topic: str
) -> None:
    token = Token(domain, "a1b2", number, number + 1, kind, namespace, node)
    if kind != "NN":
        token = token._replace(topic=topic, type="std_msgs/msg/Float64", type_hash="RIHS01_ab")
    assert read_token(token.key) == token


@given(st.text(alphabet="@ros2_lv/0NMP%:,aé*$", max_size=60))
def test_read_token_accepts_random_keys_without_error(key: str) -> None:
    token = read_token(f"@ros2_lv/{key}")
    assert token is None or token.key.startswith("@ros2_lv/")


def test_token_with_unknown_extension_is_still_read() -> None:
    token = Token(0, "a", 0, 1, "MP", "robot1", "node", "robot1/odom", ODOM.type, "RIHS01_ab")
    assert read_token(f"{token.key}/cpu:") == token
    assert read_token(f"{token._replace(kind='NN').key}/more") is not None


def test_read_route_parses_only_bridge_routes() -> None:
    key = "@/a1b2/@ros2_lv/MS/robot1§cmd_vel/geometry_msgs§msg§Twist/:1:0:0,10:typehash=RIHS01_9c;"
    assert read_route(key) == Route("a1b2", "MS", "robot1/cmd_vel", "geometry_msgs/msg/Twist")
    service = "@/a1b2/@ros2_lv/SS/robot1§reset_odometry/std_srvs§srv§Trigger"
    assert read_route(service) == Route("a1b2", "SS", "robot1/reset_odometry", "std_srvs/srv/Trigger")
    rest = ("", "robot1/odom", "@/a1b2/@ros2_lv", "@/a1b2/@ros2_lv/XX/a/b/c", "@/a1b2/@ros2_lv/MS//b/c")
    assert [read_route(other) for other in rest] == [None] * 5


@pytest.mark.parametrize(
    "key",
    [
        "", "robot1/odom", "@ros2_lv/0/abc/0/0/NN/%/%", "@ros2_lv/0/abc/0/0/XX/%/%/agent",
        "@ros2_lv/0/abc/0/0/MP/%/%/agent", "@ros2_lv/zero/abc/0/0/NN/%/%/agent",
        "@ros2_lv/0/abc/0/²/NN/%/%/agent", "@ros2_lv/0/abc//0/NN/%/%/agent",
    ],
)  # fmt: skip
def test_read_token_returns_none_for_other_keys(key: str) -> None:
    assert read_token(key) is None


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ('namespace = "/robot1"', ["namespace = '/robot1'", "without its leading slash"]),
        ('namespace = "1st"', ["namespace = '1st'", "no part beginning with a digit"]),
        ('namespace = "a//b"', ["namespace = 'a//b'"]),
        ('namespace = "a/"', ["namespace = 'a/'"]),
        ('namespace = "*"', ["namespace = '*'", "'' for none"]),
        ("domain = 233", ["domain = 233", "232"]),
        ('ros = "ros1"', ["ros = 'ros1'", "'ros2dds' or 'rmw_zenoh'"]),
        ('heading = "gyro"', ["heading = 'gyro'", "'observer' or 'measured'"]),
        ('localisation = "gps"', ["localisation = 'gps'", "'odometry' or 'external'"]),
        ('odometry_frame = "room"', ["odometry_frame = 'room'", "'world', 'start' or 'map'"]),
        ("speed_step = -0.01", ["speed_step = -0.01", "greater than or equal to 0"]),
        ("speed_step = 1", ["speed_step = 1.0", "less than its max_speed of 0.2108"]),
        ("turn_rate_step = 2.635", ["turn_rate_step = 2.635", "less than its max_turn_rate of 2.635"]),
        (
            'namespace = ""\nrobot_endpoint = "tcp/10.0.0.1:7447"',
            ["robots.robot2.namespace = ''", "apart from robot1's", "/odom"],
        ),
    ],
)
def test_error_names_illegal_ros_setting(keys: str, says: list[str]) -> None:
    with pytest.raises(MissionError) as caught:
        pair(keys)
    for words in says:
        assert words in str(caught.value)


def test_loopback_router_is_separate_on_each_machine() -> None:
    bare = 'namespace = ""\nrobot_endpoint = "tcp/127.0.0.1:7447"'
    ends = [f'endpoint = "tls/192.168.1.{number}:7460"' for number in (12, 13)]
    assert pair(bare, *ends).robots["robot2"].namespace == ""
    for agents in ((), (ends[0], ends[0].replace(":7460", ":7461"))):  # on one machine
        with pytest.raises(MissionError, match="apart from robot1"):
            pair(bare, *agents)
    with pytest.raises(MissionError, match="apart from robot1"):
        pair(bare.replace("127.0.0.1", "192.168.1.5"), *ends)


def test_robots_behind_one_router_need_distinct_topics() -> None:
    one = 'robot_endpoint = "tcp/10.0.0.1:7447"'
    assert pair(one).robots["robot2"].robot_endpoint == "tcp/10.0.0.1:7447"
    with pytest.raises(MissionError, match=r"robots\.robot2\.namespace = 'robot1'.*apart from robot1's"):
        pair(one, robot2='namespace = "robot1"')
    with pytest.raises(MissionError, match="apart from robot1"):  # a bridge's domain is not in its keys
        pair(one, robot2='namespace = "robot1"\ndomain = 5')
    apart = pair(f'{one}\nros = "rmw_zenoh"', robot2='namespace = "robot1"\ndomain = 5')
    assert apart.robots["robot2"].domain == 5
