from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import foxglove.layouts as theirs
import pytest

from formation.mission.file import load
from formation.mission.model import Mission
from formation.monitor.exporters.layout import layout, text
from formation.monitor.metrics.keys import OWN, watched
from tests.support.missions import with_robots
from tests.unit.formation.by_rosbags import STORE

NAMES = ["six_robots", "turtlebot3_pair", "two_chains"]
TYPES: dict[str, type[Any]] = {
    "3D": theirs.ThreeDeeConfig,
    "Plot": theirs.PlotConfig,
    "DiagnosticSummary": theirs.DiagnosticsSummaryConfig,
    "RosOut": theirs.LogConfig,
}
"""Class of the legal settings of each panel type, from Foxglove's own SDK."""


@pytest.fixture(params=NAMES)
def mission(request: pytest.FixtureRequest) -> Mission:
    return load(request.param)


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
        return
    assert node.keys() == {"direction", "first", "second", "splitPercentage"}
    assert node["direction"] in {"row", "column"}
    assert 0 < node["splitPercentage"] < 100
    for side in ("first", "second"):
        yield from leaves(node[side])


def assert_legal(settings: dict[str, Any], kind: type[Any]) -> None:
    """Check that the settings are named as in a file of Foxglove."""
    assert settings.keys() <= kind(**{field.name: None for field in fields(kind)})._to_dict().keys()


def test_panels_and_places_in_the_layout_match(mission: Mission) -> None:
    made = json.loads(text(mission))
    places = list(leaves(made["layout"]))
    assert sorted(places) == sorted(made["configById"])
    assert {place.partition("!")[0] for place in places} == set(TYPES)


def test_panel_settings_are_legal_in_foxglove(mission: Mission) -> None:
    panels = layout(mission)["configById"]
    for panel, config in panels.items():
        own = {key: value for key, value in config.items() if key != "foxglovePanelTitle"}  # for every panel
        assert_legal(own, TYPES[panel.partition("!")[0]])
    three = panels["3D!positions"]
    assert_legal(three["cameraState"], theirs.ThreeDeeCameraState)
    assert_legal(three["layers"]["grid"], theirs.BaseRendererGridLayerSettings)
    for topic in three["topics"].values():
        assert_legal(topic, theirs.BaseRendererPoseTopicSettings)
    for path in panels["Plot!speed"]["paths"]:
        assert_legal(path, theirs.PlotSeries)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["twist", "twist_stamped"])
def test_layout_topics_exist_and_series_are_numbers(name: str, kind: str) -> None:
    mission = with_robots(name, cmd_vel=kind)
    types = {f"/{one.key}": one.topic.type for one in (*watched(mission), *OWN)}
    panels = layout(mission)["configById"]
    shown = {panels[one]["topicToRender"] for one in ("DiagnosticSummary!fleet", "RosOut!events")}
    assert {*panels["3D!positions"]["topics"], *shown} <= set(types)
    plots = [config for panel, config in panels.items() if panel.startswith("Plot!")]
    for value in (path["value"] for plot in plots for path in plot["paths"]):
        if not value.startswith("/"):
            assert float(value)  # a constant line
            continue
        topic, *path = value.split(".")
        ros_type = types[topic]
        for step in path:
            kinds = dict(STORE.get_msgdef(ros_type).fields)
            assert step in kinds, value
            ros_type = str(kinds[step][1]) if isinstance(kinds[step][1], str) else str(kinds[step][1][0])
        assert ros_type == "float64", value


def test_layout_shows_all_robots_and_follower_commands() -> None:
    mission = load("two_chains")
    panels = layout(mission)["configById"]
    assert len(panels["3D!positions"]["topics"]) == len(mission.names)
    for plot in ("Plot!speed", "Plot!turn_rate"):
        assert [path["label"] for path in panels[plot]["paths"]] == [*mission.followers, "limit", "−limit"]
