"""A picture of a formation on its way round posts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.patches import Circle

from tests.campaigns.plots import BLUE, INK, ORANGE, panels
from tests.campaigns.safety.layouts import BODY, HEAD, layout, mission
from tests.support.fleet import Fleet

FIGURE = "figures/safety_posts.svg"
SECONDS, STEP = 36.0, 0.1
"""What is shown, and from point to point of a path [s]."""
MOMENTS = (8.0, 22.0, 36.0)
"""At which bodies are drawn [s]."""


def draw(seed: int, folder: Path) -> None:
    """Paths of all robots past one layout, with noise and lost beams, into docs/figures."""
    posts = layout(seed)
    fleet = Fleet(mission(posts, worse=True), seed=seed)
    places = []
    for _ in range(round(SECONDS / STEP)):
        fleet.run(STEP)
        leader = fleet.points()[0]  # has all be where they are by now
        places.append([leader, *(fleet.plant(name).position for name in fleet.mission.followers)])
    way = np.array(places) * HEAD.conjugate()
    with panels(folder / Path(FIGURE).name, 1, (7.0, 3.4), {"svg.hashsalt": "safety"}) as (axes,):
        axes.plot(way[:, 0].real, way[:, 0].imag, color=INK, linewidth=1.0, linestyle="--")
        axes.plot(way[:, 1:].real, way[:, 1:].imag, color=BLUE, linewidth=1.0)
        for moment in MOMENTS:
            for at in way[round(moment / STEP) - 1, 1:]:
                axes.add_patch(Circle((at.real, at.imag), BODY, color=BLUE, alpha=0.5, linewidth=0.0))
        for post in posts:
            at = post.at * HEAD.conjugate()
            axes.add_patch(Circle((at.real, at.imag), post.radius, color=ORANGE))
        axes.set_aspect("equal")
        axes.set_xlabel("along the leader's way [m]")
        axes.set_ylabel("to the left of it [m]")
