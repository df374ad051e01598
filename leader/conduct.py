"""What whoever leads does: goes along its course, moves the figure, waits, and obeys its operator.

The next to lead goes on from the newest order that anybody relays (`Conduct.restore`), so an order says all
of this but the course, which is told apart (`leader.course`).
"""

from __future__ import annotations

import cmath
import math

from formation import intent
from formation.figure import Figure
from formation.geofence import GRAIN, Geofence
from formation.mission import Mission
from formation.order import Mode, OperatorRequest, Order, Slots, Tuned
from formation.rest import MOTION, Result
from formation.stability import spectrum, tuning
from leader.course import Course
from leader.mover import Mover, Wish
from leader.together import Together
from leader.will import Will

ASTRAY = 0.05
"""A route that puts the leader further from where it was is not the one that it was on [m]."""
STOPS = 1.0
"""The leader stops at the bounds so long before its team would leave them: robots roll on a little [s]."""
REMEMBERED = 16
"""So many courses that others told are known."""
LONGEST_TIME = 1e9
"""[s]"""


class Conduct:
    """The will, the course, the figure and the patience of whoever leads."""

    def __init__(self, mission: Mission, *, hold: bool = False) -> None:
        """With `hold` it waits at its start until it is told to run."""
        self.will = Will(hold=hold)
        self.course = Course.of(mission)
        self.route_time = 0.0
        """How long it has been on its course, and so where on it it is [s]."""
        self.mover = Mover.first(mission)
        self.together = Together(mission)
        self.tuned: Tuned | None = None
        """Gains in the place of the mission's."""
        self.fenced = ""
        """What would leave the bounds if it went on, in words; empty while nothing would."""
        self._mission, self._fence = mission, Geofence(mission)
        self._courses = {"": self.course}

    @property
    def wanted(self) -> Figure:
        """The figure that is wanted, its rotation as an order says it."""
        wish = self.mover.wish
        return Figure(((wish.shape, 1.0),), wish.rotation, wish.scale)

    def where(self, ahead: float = 0.0) -> complex:
        """The leader's position [m; world frame], so long [s] after the newest step if it runs on."""
        return self.course.position(self.route_time + self.pace * ahead)

    @property
    def pace(self) -> float:
        """Share of its speed that the leader goes at."""
        return 0.0 if self.fenced else self.together.pace

    def go_on(self, mono: float, dt: float, mode: Mode) -> None:
        """Spend the `dt` [s] before `mono` in the mode that was in force.

        Slots move only while the team runs: robots that stand could not follow, and would have to make up for
        all of it at once.
        """
        if mode != "run":
            self.mover.rest()
            return
        before, figure = self.route_time, self.mover.figure
        pace = self.together.step(mono, dt, self.where(), self.course.velocity(before), figure)
        self.fenced = self._fenced(dt)
        self.route_time += 0.0 if self.fenced else pace * dt
        self.mover.advance(
            dt,
            pace,
            self.course.fastest(before, self.route_time),
            self.course.heading(self.route_time),
            0.0 if self.fenced else self.course.turn_rate(self.route_time),
        )

    def _fenced(self, dt: float) -> str:
        """What would leave the bounds if the leader went on for `dt` [s] and `STOPS` more, in words."""
        time = self.route_time + dt + STOPS
        here, there = self.where(), self.course.position(time)
        figure, wish = self.mover.figure, self.mover.wish
        if here == there or self._fence.clear_of(there, max(figure.scale, wish.scale)):
            return ""
        figures = self.mover.ahead(self.course.heading(time))
        now = self._fence.breach(figures, here, self._fence.clearance)
        then = self._fence.breach(figures, there, self._fence.clearance)
        return "" if then.excess <= max(now.excess, 0.0) + GRAIN else then.words

    def learn(self, course: Course) -> bool:
        """Another candidate told its course; whether this is the one that was wanting."""
        self._courses.pop(course.id, None)
        self._courses[course.id] = course
        while len(self._courses) > REMEMBERED:
            del self._courses[next(name for name in self._courses if name)]
        if self.course.known or course.id != self.course.id or not course.id:
            return False
        self.course, self.will.lost = course, ""
        return True

    def restore(self, order: Order) -> None:
        """Go on from what another leader said last."""
        self.will.restore(order)
        self.route_time, self.will.lost, self.fenced = order.time, "", ""
        course = self._courses.get(order.route)
        there = None if order.place is None else complex(order.place.x, order.place.y)
        if course is not None and (there is None or abs(course.position(order.time) - there) <= ASTRAY):
            self.course = course
        elif order.place is not None:
            self.course = Course.standing(order.route, order.place)
            self.will.lost = "does not know the route that the leader was on: order a speed or a route"
        borne = order.tuned is None or tuning.refusal(self._mission, order.tuned) is None
        self.tuned = order.tuned if borne else None
        wish = Wish(order.shape, order.rotation, order.scale)
        self.mover = Mover(self._mission, Figure.of(order), wish, self._speed)

    def order(self, term: int, beat: int, mode: Mode) -> Order:
        """What to say of it."""
        wish = self.mover.wish
        return Order(
            term=term,
            beat=beat,
            mode=mode,
            shape=wish.shape,
            rotation=wish.rotation,
            scale=wish.scale,
            slots=None if self.mover.arrived and not self._mission.turning else slots_of(self.mover.figure),
            told=self.will.told,
            holding=bool(self.will.rest.hold),
            route=self.course.id,
            time=round(min(self.route_time, LONGEST_TIME), 3),
            place=self.course.place(self.route_time),
            tuned=self.tuned,
        )

    def obey(self, request: OperatorRequest, fact: str) -> Result:
        """Whether it does what an operator asks; `fact` is the id of a stop or a hold that this leaves."""
        if request.do in MOTION:
            return self.will.change(request, fact)
        if request.do in {"speed", "route"}:
            return Result(*self._set_out(request))
        if request.do == "tune":
            return Result(*self._tune(request))
        return Result(*self._change_figure(request))

    def _set_out(self, request: OperatorRequest) -> tuple[bool, str]:
        """On another course, from where it is."""
        why = intent.refusal(self._mission, request, self.wanted)
        if why is not None:
            return False, why
        start, heading = self.where(), self.course.heading(self.route_time)
        course = self.course
        if request.legs is not None:
            course = Course.ordered(request.legs, start, heading)
        elif request.speed is not None and request.degrees is not None:
            course = Course.endless(request.speed, request.degrees, start, heading)
        figures = (self.wanted, self._turned_back(self.mover.figure))
        why, notice = intent.leaves(self._fence, course.route, figures, heading)
        if why is not None:
            return False, why
        self.course = course
        self.learn(self.course)
        self.route_time, self.will.lost, self.fenced = 0.0, "", ""
        lasts = "without an end" if math.isinf(self.course.total) else f"of {self.course.total:.3g} s"
        said = f"on a route {lasts} from where it is"
        return True, f"{said}; {notice}" if notice else said

    def _turned_back(self, figure: Figure) -> Figure:
        """The figure with its rotation as an order says it: with ``turning`` from the leader's heading."""
        if not self._mission.turning:
            return figure
        heading = self.course.heading(self.route_time)
        return figure._replace(rotation=figure.rotation - cmath.phase(heading))

    @property
    def gains(self) -> Tuned:
        """Of the law, as everybody is to have them."""
        law = self._mission.law
        return self.tuned or Tuned.model_construct(k_p=law.k_p, k_i=law.k_i)

    def _tune(self, request: OperatorRequest) -> tuple[bool, str]:
        wanted = intent.tuned(request, self.gains)
        why = intent.refusal(self._mission, request, gains=wanted)
        if why is not None:
            return False, why
        law = self._mission.law
        self.tuned = None if (wanted.k_p, wanted.k_i) == (law.k_p, law.k_i) else wanted
        margin = spectrum.delay_margin(spectrum.laplacian(self._mission.graph), wanted.k_p, wanted.k_i)
        return True, f"{wanted.words}; bears a delay of {margin * 1e3:.0f} ms"

    def _change_figure(self, request: OperatorRequest) -> tuple[bool, str]:
        before = self.mover.wish
        figure = intent.wish(request, self.wanted)
        shape = before.shape if request.shape is None else request.shape
        if figure is None or shape not in self._mission.shapes:
            return False, intent.refusal(self._mission, request, self.wanted) or "no such figure"
        wish = Wish(shape, figure.rotation, figure.scale)
        way = self.mover.way(wish, self._speed)
        if not self.mover.sayable(way):
            return False, f"still changing for {self.mover.remaining:.1f} s: ask again then"
        figures = self.mover.figures(way)
        why = intent.refusal(
            self._mission, request, self.wanted, figures, self.course.legs, place=self.where()
        ) or self._leaves_later(figure)
        if why is not None:
            return False, why
        changes = wish != before or not self.mover.arrived
        self.mover.go(wish, way)
        what = f"in shape {wish.shape}"
        if request.do == "rotate":
            what = f"turned by {math.degrees(wish.rotation):.4g}°"
        elif request.do == "scale":
            what = f"at scale {wish.scale:.4g}"
        if not changes:
            return True, what
        return (
            True,
            f"{what} in {self.mover.remaining:.1f} s{'' if self.will.mode == 'run' else ' of running'}",
        )

    def _leaves_later(self, figure: Figure) -> str | None:
        """Why a figure cannot be taken along the rest of a route that ends; None if it can."""
        if math.isinf(self.course.total):
            return None
        route, heading, since = self.course.route, self.course.heading(self.route_time), self.route_time
        before, _ = intent.leaves(self._fence, route, (self.wanted,), heading, since)
        why, _ = intent.leaves(self._fence, route, (figure,), heading, since)
        return None if before else why

    @property
    def _speed(self) -> float:
        return self.course.fastest(self.route_time, self.route_time)


def slots_of(figure: Figure) -> Slots:
    """A figure as an order says it: a ten-millionth is near enough."""
    mix = {shape: min(round(share, 7), 1.0) for shape, share in figure.mix if round(share, 7) > 0.0}
    return Slots(mix=mix, rotation=round(figure.rotation, 7), scale=round(figure.scale, 7))
