"""A layout file for Foxglove, made for a mission: robots' positions, errors and commands.

The format is that of Foxglove's own exported layouts: panels by ``Type!name`` with what is set in them, and
how they share the window. Pure; `python -m formation.monitor MISSION --foxglove-layout FILE` writes it.
"""

from __future__ import annotations

import json
import math
from typing import Any

from formation.mission.model import Mission
from formation.topics import CMD_VEL, DIAGNOSTICS, ERROR, EVENTS, POSITION

FRAME = "map"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D1F")
"""Colours of the followers in turn, after Okabe and Ito: distinct for colour-blind readers."""
LEADER, LIMIT = "#808080", "#A0A0A0"
ARROW = (0.35, 0.07, 0.07)
"""Length, width and height of a robot's arrow [m]."""
GRID_EXTENT = 60
"""Extent of the grid in each direction [m]."""
Config = dict[str, Any]


def layout(mission: Mission) -> Config:
    """Return the layout as data."""
    panels = {
        "3D!positions": _top_view(mission),
        "Plot!error": _error(mission),
        "Plot!speed": _commands(mission, "u [m/s]", "linear.x", "max_speed"),
        "Plot!turn_rate": _commands(mission, "ω [rad/s]", "angular.z", "max_turn_rate"),
        "DiagnosticSummary!fleet": {
            "minLevel": 0,
            "pinnedIds": [],
            "hardwareIdFilter": "",
            "topicToRender": f"/{DIAGNOSTICS.key()}",
            "sortByLevel": True,
        },
        "RosOut!events": {"searchTerms": [], "minLogLevel": 1, "topicToRender": f"/{EVENTS.key()}"},
    }
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split(
            "row",
            _split("column", "3D!positions", "Plot!error", 68),
            _split(
                "column",
                _split("column", "Plot!speed", "Plot!turn_rate", 50),
                _split("column", "DiagnosticSummary!fleet", "RosOut!events", 50),
                50,
            ),
            58,
        ),
    }


def text(mission: Mission) -> str:
    """Return the text of the layout file."""
    return json.dumps(layout(mission), indent=2, ensure_ascii=False) + "\n"


def _top_view(mission: Mission) -> Config:
    arrow = {"visible": True, "type": "arrow", "arrowScale": list(ARROW)}
    far = max(math.hypot(robot.start.x, robot.start.y) for robot in mission.robots.values())
    return {
        "foxglovePanelTitle": f"{mission.name} from above",
        "cameraState": {
            "perspective": False,
            "distance": round(10.0 + 4.0 * far, 1),
            "phi": 0,
            "thetaOffset": 0,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.5,
            "far": 5000,
        },
        "followMode": "follow-none",
        "followTf": FRAME,
        "scene": {},
        "transforms": {},
        "topics": {
            f"/{POSITION.key(name)}": {**arrow, "color": colour} for name, colour in _coloured(mission)
        },
        "layers": {
            "grid": {
                "instanceId": "grid",
                "layerId": "foxglove.Grid",
                "label": "metres",
                "visible": True,
                "frameId": FRAME,
                "size": GRID_EXTENT,
                "divisions": GRID_EXTENT,
                "lineWidth": 1,
                "color": "#80808060",
                "position": [0, 0, 0],
                "rotation": [0, 0, 0],
            }
        },
    }


def _error(mission: Mission) -> Config:
    series = [
        _series(f"/{ERROR.key()}.data", "formation error", "#1F4E79"),
        _series(f"{mission.settled:g}", "settled under", LIMIT),
    ]
    return {**_plot("formation error [m]", series), "minYValue": 0}


def _commands(mission: Mission, title: str, field: str, limited_by: str) -> Config:
    """Return a plot of one command component of every follower, with its limits."""
    series = []
    for name, colour in _coloured(mission):
        if name != mission.leader:
            path = field if mission.robots[name].cmd_vel == "twist" else f"twist.{field}"
            series.append(_series(f"/{CMD_VEL.key(name)}.{path}", name, colour))
    limit = max(float(getattr(mission.robots[name], limited_by)) for name in mission.followers)
    bounds = [_series(f"{sign * limit:g}", label, LIMIT) for sign, label in ((1, "limit"), (-1, "−limit"))]
    return _plot(title, series + bounds)


def _plot(title: str, series: list[Config]) -> Config:
    return {
        "foxglovePanelTitle": title,
        "paths": series,
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "sidebarDimension": 240,
    }


def _series(value: str, label: str, colour: str) -> Config:
    """Return one line of a plot; a numeric `value` gives a horizontal line."""
    return {
        "value": value,
        "enabled": True,
        "timestampMethod": "receiveTime",
        "label": label,
        "color": colour,
        "showLine": True,
        "lineSize": 1.5,
    }


def _split(direction: str, first: Config | str, second: Config | str, percent: float) -> Config:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percent}


def _coloured(mission: Mission) -> list[tuple[str, str]]:
    colours = {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(mission.followers)}
    return [(name, colours.get(name, LEADER)) for name in mission.names]
