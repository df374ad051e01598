from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import foxglove.layouts as theirs
import pytest

from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.monitor.exporters.layout import layout, text
from formation.monitor.metrics.keys import OWN, watched
from tests.unit.formation.by_rosbags import STORE

MISSIONS = ("six_robots", "turtlebot3_pair", "two_chains")
TYPES: dict[str, type[Any]] = {
    "3D": theirs.ThreeDeeConfig,
    "Plot": theirs.PlotConfig,
    "DiagnosticSummary": theirs.DiagnosticsSummaryConfig,
    "RosOut": theirs.LogConfig,
}
"""What may be set in a panel, by what a layout file calls its type, as Foxglove's own SDK has it."""


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        assert set(node) == {"direction", "first", "second", "splitPercentage"}
        assert node["direction"] in {"row", "column"}
        assert 0 < node["splitPercentage"] < 100
        yield from leaves(node["first"])
        yield from leaves(node["second"])


def legal(kind: type[Any]) -> set[str]:
    """Names of what may be set, as they are spelled in a file."""
    return set(kind(**{field.name: None for field in fields(kind)})._to_dict())


def series(mission: Mission) -> Iterator[str]:
    for panel, config in layout(mission)["configById"].items():
        if panel.startswith("Plot!"):
            yield from (path["value"] for path in config["paths"])


@pytest.mark.parametrize("name", MISSIONS)
def test_every_panel_has_its_place_and_every_place_its_panel(name: str) -> None:
    made = json.loads(text(load(name)))
    places = list(leaves(made["layout"]))
    assert sorted(places) == sorted(made["configById"])
    assert {place.partition("!")[0] for place in places} == set(TYPES)


@pytest.mark.parametrize("name", MISSIONS)
def test_panel_settings_are_legal_in_foxglove(name: str) -> None:
    for panel, config in layout(load(name))["configById"].items():
        settings = set(config) - {"foxglovePanelTitle"}  # which is of every panel
        assert settings <= legal(TYPES[panel.partition("!")[0]]), panel
    three = layout(load(name))["configById"]["3D!positions"]
    assert set(three["cameraState"]) <= legal(theirs.ThreeDeeCameraState)
    assert set(three["layers"]["grid"]) <= legal(theirs.BaseRendererGridLayerSettings)
    for topic in three["topics"].values():
        assert set(topic) <= legal(theirs.BaseRendererPoseTopicSettings)
    for path in layout(load(name))["configById"]["Plot!speed"]["paths"]:
        assert set(path) <= legal(theirs.PlotSeries)


@pytest.mark.parametrize("name", MISSIONS)
@pytest.mark.parametrize("kind", ["twist", "twist_stamped"])
def test_layout_topics_exist_and_series_are_numbers(name: str, kind: str) -> None:
    source, where = read(name)
    before = f'cmd_vel = "{"twist_stamped" if kind == "twist" else "twist"}"'
    mission = parse(source.replace(before, f'cmd_vel = "{kind}"'), where)
    types = {f"/{one.key}": one.topic.type for one in (*watched(mission), *OWN)}
    panels = layout(mission)["configById"]
    assert set(panels["3D!positions"]["topics"]) <= set(types)
    assert {panels[one]["topicToRender"] for one in ("DiagnosticSummary!fleet", "RosOut!events")} <= set(
        types
    )
    for value in series(mission):
        if not value.startswith("/"):
            assert float(value)  # a line across
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
