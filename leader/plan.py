"""What the leader does: drives its route, moves the shape, waits, and obeys its operator.

The next leader goes on from the newest relayed order (`Plan.restore`), so an order holds all of this but
the route, which is published separately (`formation.leader.route`).
"""

from __future__ import annotations

import cmath
import math
from typing import Literal

from formation.leader.cohesion import Cohesion
from formation.leader.driving import IDLE_SECONDS, Driver
from formation.leader.joining import Joined, joined
from formation.leader.relays import Relays
from formation.leader.route import NamedRoute
from formation.leader.shape_transition import OrderedShape, ShapeTransition
from formation.mission.model import Mission
from formation.mission.route import Leg, Straight
from formation.protocol.attachment import MAX_SIGNED_BYTES
from formation.protocol.json_message import encode
from formation.protocol.order import DRIVEN_ROUTE, Mode, Motion, Order, Slots, Tuned
from formation.protocol.reasons import Code, Reason
from formation.protocol.request import OperatorRequest
from formation.protocol.stops import MOTION, Rest, Result
from formation.slots.geofence import LENGTH_TOLERANCE, Breach, Geofence
from formation.slots.shape import PlacedShape
from formation.stability import intent, spectrum, tuning
from formation.stability.driving import STANDS, Velocity, limits

MAX_ROUTE_DISTANCE = 0.05
"""Largest distance between a route and the leader's last place for which it is taken as its route [m]."""
BOUNDS_STOP_TIME = 1.0
"""How long before its fleet would leave the bounds the leader stops, as robots roll on a little [s]."""
MAX_ROUTES = 16
"""Number of published routes that are kept."""
MAX_ROUTE_TIME = 1e9
"""Longest route time in an order [s]."""


class TeamMode:
    """The mode of a candidate, and how an operator changes it."""

    def __init__(self, *, hold: bool = False, publisher_id: str = "") -> None:
        """With `hold`, the fleet waits until told to run, unless it is under way.

        `publisher_id` is that of its process, and in the ids of its own holds: no earlier request names them.
        """
        self.base_mode: Literal["hold", "run"] = "run"
        """The mode in force without a stop or a hold."""
        self.rest = Rest()
        """The operator's stop and hold. Each candidate keeps them, also while another leads."""
        self.lost: Reason | None = None
        """Why it cannot run even if told to."""
        self.undriven = False
        """Whether it is driven by hand, and no velocity comes."""
        self.unread = False
        """Whether its own hold is in force because it could not read the order that robots relay."""
        self._hold, self._publisher_id = hold, publisher_id
        self._own_hold, self._own_holds = "", 0  # id of the newest hold of its own, and how many there were
        self._run_requested = False  # whether it was told to run after the relayed order
        if hold:
            self.hold_until_run("start")

    @property
    def hold(self) -> str:
        """Id of the hold that ``run`` has to name: an operator's, else its own; empty for none."""
        return self.rest.hold or (self._own_hold if self.base_mode == "hold" else "")

    @property
    def mode(self) -> Mode:
        """The mode in force: a stop overrides a hold, and a hold the base mode."""
        return self.rest.mode or ("hold" if self.lost or self.undriven else self.base_mode)

    def change(self, request: OperatorRequest, rest_id: str, *, leads: bool = True) -> Result:
        """Obey ``run``, ``hold``, ``stop`` or ``release``; `rest_id` is the id of the resulting stop or hold.

        A standby (`leads` is False) drops the hold that ``run`` ends; the rest comes from the leader's
        order.
        """
        if request.do == "run" and leads and self.lost and not self.rest.stop:
            return Result(ok=False, reason=str(self.lost))
        if request.do != "run" or not leads:
            return self.rest.change(request, rest_id)
        result = Rest(self.rest.stop, self.hold).change(request, rest_id)
        if result.ok:
            self.rest.hold, self.base_mode, self._run_requested, self.unread = "", "run", True, False
            if self.undriven:
                return result._replace(reason=str(Reason.of(Code.NOT_DRIVEN)))
        return result

    def hold_until_run(self, why: str) -> None:
        """Hold the fleet until told to run; `why` begins the hold's id."""
        self._own_holds += 1
        self._own_hold = f"{why}-{self._publisher_id}-{self._own_holds}"
        self.base_mode, self._run_requested = "hold", False

    def hold_until_read(self) -> None:
        """Hold until told to run, or until the order that robots relay can be read."""
        self.hold_until_run("unread")
        self.unread = True

    def restore(self, order: Order, *, under_way: bool = True) -> None:
        """Take over another leader's mode. A stop or a hold of either stays.

        `under_way`: that leader's beat rose a moment ago. If not, a leader started to hold waits for ``run``.
        """
        self.inherit_stop(order)
        self.unread = False
        if self._run_requested:
            return
        if order.base_mode == "run" and (under_way or not self._hold):
            self.base_mode = "run"
        elif self.base_mode == "run":
            self.hold_until_run("term")
        if order.holding:
            self.rest.hold = self.rest.hold or f"term-{order.term}"

    def hold_after_suspension(self) -> None:
        """Hold until told to run, if started to hold: the fleet was without a leader for long."""
        if self._hold:
            self.hold_until_run("slept")

    def inherit_stop(self, order: Order) -> None:
        """Stop if another leader was stopped. An order has no ids, so the stop gets a new one."""
        if order.mode == "stop":
            self.rest.stop = self.rest.stop or f"term-{order.term}"

    def replace_lost(self) -> bool:
        """Forget the lost route, which an order replaces; only ``run`` starts the fleet on the other one.

        Return whether a route was lost.
        """
        if self.lost is None:
            return False
        self.lost = None
        self.hold_until_run("route")
        return True

    def hold_at_end(self) -> None:
        """Leave a hold to the next leader, as this one ends and no standby takes its place."""
        self.hold_until_run("ended")

    def stand_by(self) -> None:
        """Become a standby: the mode is later restored from the leader's orders."""
        self.lost, self.undriven, self._run_requested = None, False, False


class Plan:
    """The mode, the route, the shape and the cohesion of a leader."""

    def __init__(
        self, mission: Mission, *, hold: bool = False, signed: bool = False, publisher_id: str = ""
    ) -> None:
        """With `hold`, wait until told to run, unless the fleet is under way; `signed`: orders are signed.

        `publisher_id` is that of its process.
        """
        self.team_mode = TeamMode(hold=hold, publisher_id=publisher_id)
        self.route = NamedRoute.of(mission)
        self.route_time = 0.0
        """Time on its route, which gives its place on it [s]."""
        self._driven_time = 0.0  # time on its route before it was driven, and driven since [s]
        self.shape_transition = ShapeTransition.first(mission)
        self.cohesion = Cohesion(mission)
        self.tuned: Tuned | None = None
        """Gains that replace the mission's."""
        self.driver = Driver(publisher_id)
        """Its velocity where it is driven by hand."""
        self.relays = Relays()
        """How late robots have its orders."""
        self.fenced: Breach | None = None
        """What would leave the bounds if the leader went on; None if nothing."""
        self.tells_motion = mission.law.uses_orders(signed=signed)
        """Whether orders give the leader's velocity."""
        self._mission, self._fence, self._publisher_id = mission, Geofence(mission), publisher_id
        self._routes = {"": self.route}
        # the path that it has joined: its legs, the length of it that was behind [m], and the route's id
        self._path: tuple[tuple[Leg, ...], float, str] | None = None

    @property
    def wanted(self) -> PlacedShape:
        """The wanted shape, with its rotation as in an order."""
        ordered = self.shape_transition.ordered
        return PlacedShape(((ordered.shape, 1.0),), ordered.rotation, ordered.scale)

    def where(self, ahead: float = 0.0) -> complex:
        """Return the leader's position [m; world frame] `ahead` [s] after the newest step if it runs on."""
        return self.route.where(self.route_time + self.pace * ahead)

    @property
    def pace(self) -> float:
        """Share of its speed that the leader uses."""
        return self.cohesion.pace if self.fenced is None else 0.0

    def go_on(self, mono: float, dt: float, mode: Mode) -> None:
        """Advance by the `dt` [s] before `mono` in the mode that was in force.

        Slots move only while the fleet runs: robots that stand could not follow, and would have to catch up
        all at once.
        """
        if mode != "run":
            self.shape_transition.rest()
            return
        if self.driven:
            slots = [self.wanted.slot(self._mission, name) for name in self._mission.followers]
            self._drive_from_here(self.driver.advance(limits(self._mission, slots, self.gains.k_p), dt, mono))
            self._driven_time += dt
        before, placed_shape = self.route_time, self.shape_transition.placed_shape
        pace = self.cohesion.step(
            mono, dt, self.where(), self.route.velocity(before), placed_shape, driven=self.driven
        )
        self.fenced = self._fenced(dt)
        self.route_time += pace * dt if self.fenced is None else 0.0
        self.shape_transition.advance(
            dt,
            pace,
            self.route.max_speed(before, self.route_time),
            self.route.heading(self.route_time),
            self.route.turn_rate(self.route_time) if self.fenced is None else 0.0,
        )

    @property
    def driven(self) -> bool:
        """Whether it is driven by hand."""
        return self.route.id == DRIVEN_ROUTE

    @property
    def driver_due(self) -> float:
        """When the driver's velocity expires [s, monotonic]; infinite if none counts."""
        return self.driver.until if self.driven and not self.team_mode.undriven else math.inf

    def check_driver(self, mono: float) -> None:
        """Hold the fleet, at `mono` [s], if it is driven by hand and no velocity comes."""
        self.team_mode.undriven = self.driven and not self.driver.live(mono)
        if self.team_mode.undriven:
            self.driver.stand()

    def drive(self, request: OperatorRequest, received: float) -> Result:
        """Take a driver's velocity, received at `received` [s, monotonic]."""
        mode, held = self.team_mode, Result(ok=False, reason="held: order run first")
        refusal = None
        if mode.rest.stop:
            refusal = Result(ok=False, reason="stopped: release it, then order run", code="stopped")
        elif mode.rest.mode or (mode.base_mode == "hold" and mode.lost is None):
            refusal = held
        elif why := self.relays.late(received):
            refusal = Result(ok=False, reason=why)
        velocity = Velocity(request.forward or 0.0, request.turn_rate or 0.0)
        result = self.driver.accept(request.id, velocity, request.token or 0, received, refusal)
        if result.ok and not self.driven:
            self._driven_time = self.route_time
            self._drive_from_here()
            return held if mode.replace_lost() else result
        return result

    def _drive_from_here(self, velocity: Velocity = STANDS) -> None:
        heading = self.route.heading(self.route_time)
        self.route, self.route_time = NamedRoute.driven(self.where(), heading, *velocity), 0.0

    @property
    def waits_for(self) -> tuple[str, ...]:
        """Robots for which a fleet that is told to run waits."""
        stands = self.team_mode.mode != "run" or self.fenced is not None
        return () if stands else self.cohesion.waits_for

    @property
    def in_force(self) -> tuple[object, ...]:
        """What operators have ordered; a change is published at once."""
        return self.team_mode.mode, self.shape_transition.ordered, self.route.id, self.tuned

    def _fenced(self, dt: float) -> Breach | None:
        """Return what would leave the bounds in `dt` [s] and `BOUNDS_STOP_TIME` more."""
        time = self.route_time + dt + BOUNDS_STOP_TIME
        here, there = self.where(), self.route.where(time)
        facing, turned = self.route.heading(self.route_time), self.route.heading(time)
        if here == there and facing == turned:
            return None
        placed_shape, ordered = self.shape_transition.placed_shape, self.shape_transition.ordered
        if self._fence.clear_of(there, max(placed_shape.scale, ordered.scale)):
            return None
        now = self._fence.breach(self.shape_transition.ahead(facing), here, self._fence.clearance)
        then = self._fence.breach(self.shape_transition.ahead(turned), there, self._fence.clearance)
        return None if then.excess <= max(now.excess, 0.0) + LENGTH_TOLERANCE else then

    def add_route(self, route: NamedRoute) -> bool:
        """Keep a published route; return whether it is the one that was missing."""
        self._routes.pop(route.id, None)
        self._routes[route.id] = route
        while len(self._routes) > MAX_ROUTES:
            del self._routes[next(name for name in self._routes if name)]
        if self.route.legs or route.id != self.route.id or not route.id:
            return False
        self.route, self.team_mode.lost = route, None
        return True

    def restore(self, order: Order, *, under_way: bool = True, mono: float = -math.inf) -> None:
        """Go on at `mono` [s] from another leader's last order; `under_way`: its beat rose a moment ago."""
        self.team_mode.restore(order, under_way=under_way)
        self.route_time, self.team_mode.lost, self.fenced = order.time, None, None
        if order.driven and order.place is not None:
            at, heading = complex(order.place.x, order.place.y), cmath.rect(1.0, order.place.heading)
            self.route, self.route_time = NamedRoute.driven(at, heading, 0.0, 0.0), 0.0
            self._driven_time = order.time
            self.driver = Driver(self._publisher_id, mono)
            self._restore_shape(order)
            return
        self.driver.end()
        route = self._routes.get(order.route)
        there = None if order.place is None else complex(order.place.x, order.place.y)
        if route is not None and (
            there is None or abs(route.where(order.time) - there) <= MAX_ROUTE_DISTANCE
        ):
            self.route = route
        elif order.place is not None:
            self.route = NamedRoute.standing(order.route, order.place)
            self.team_mode.lost = Reason(Code.ROUTE_UNKNOWN)
        self._restore_shape(order)

    def _restore_shape(self, order: Order) -> None:
        acceptable = order.tuned is None or tuning.refusal(self._mission, order.tuned) is None
        self.tuned = order.tuned if acceptable else None
        ordered = OrderedShape(order.shape, order.rotation, order.scale)
        self.shape_transition = ShapeTransition(self._mission, PlacedShape.of(order), ordered, self._speed)

    def order(self, term: int, beat: int, mode: Mode) -> Order:
        """Return the order to publish; without the motion, if it would be too long to be signed."""
        motion = (
            self.route.motion(self.route_time, self.pace) if self.tells_motion and mode == "run" else None
        )
        whole = self._order(term, beat, mode, motion)
        fits = motion is None or len(encode(whole)) <= MAX_SIGNED_BYTES
        return whole if fits else self._order(term, beat, mode, None)

    def _order(self, term: int, beat: int, mode: Mode, motion: Motion | None) -> Order:
        ordered = self.shape_transition.ordered
        return Order(
            term=term,
            beat=beat,
            mode=mode,
            shape=ordered.shape,
            rotation=ordered.rotation,
            scale=ordered.scale,
            slots=None
            if self.shape_transition.arrived and not self._mission.turning
            else slots_of(self.shape_transition.placed_shape),
            base_mode=self.team_mode.base_mode,
            holding=bool(self.team_mode.rest.hold),
            route=self.route.id,
            time=round(min(self._driven_time if self.driven else self.route_time, MAX_ROUTE_TIME), 3),
            place=self.route.place(self.route_time),
            motion=motion,
            tuned=self.tuned,
            driven=self.driven,
        )

    def obey(self, request: OperatorRequest, rest_id: str, received: float) -> Result:
        """Obey a request of `received` [s, monotonic]; `rest_id` is that of a stop or hold which results."""
        if request.do in MOTION:
            return self.team_mode.change(request, rest_id)
        if request.joins and self.driven and self.driver.drives(received):
            driver = self.driver.name or "a driver"
            why = f"{driver} drives by hand; goals and paths count {IDLE_SECONDS:g} s later"
            return Result(ok=False, reason=why, code="driven")
        if request.do in {"speed", "route"}:
            return Result(*self._change_route(request))
        if request.do == "tune":
            return Result(*self._tune(request))
        return Result(*self._change_shape(request))

    def _change_route(self, request: OperatorRequest) -> tuple[bool, str]:
        """Obey a speed or a route; return whether, and the answer."""
        why = intent.refusal(self._mission, request, self.wanted, gains=self.gains)
        if why is not None:
            return False, why
        start, heading = self.where(), self.route.heading(self.route_time)
        route, path = self.route, None
        if request.legs is not None:
            path = self._joined(request.legs, start, heading) if request.joins else None
            route = NamedRoute.ordered(path.legs if path else request.legs, start, heading)
        elif request.speed is not None and request.degrees is not None:
            leg = Straight(speed=request.speed, heading_deg=request.degrees)
            route = NamedRoute.ordered((leg,), start, heading)
        placed_shapes = (self.wanted, self._relative_to_leader(self.shape_transition.placed_shape))
        why, notice = intent.leaves(self._fence, route, placed_shapes, heading)
        if why is not None:
            return False, why
        self.route = route
        self._path = (request.legs, path.passed, route.id) if request.legs and path else None
        self.add_route(self.route)
        self.route_time, self.fenced = 0.0, None
        self.driver.end()
        waits = self.team_mode.replace_lost()
        lasts = "without an end" if math.isinf(self.route.total) else f"of {self.route.total:.3g} s"
        answer = f"on a route {lasts} from where it is{', once you order run' if waits else ''}"
        return True, f"{answer}; {notice}" if notice else answer

    def _joined(self, legs: tuple[Leg, ...], place: complex, heading: complex) -> Joined:
        """Return what is left of a path; of the one that it is on, what is left of that."""
        known = self._path
        same = known is not None and (known[0], known[2]) == (legs, self.route.id)
        return joined(legs, place, heading, known[1] if known and same else 0.0)

    def _relative_to_leader(self, placed_shape: PlacedShape) -> PlacedShape:
        """Return the shape with its rotation as in an order: with ``turning`` relative to the heading."""
        if not self._mission.turning:
            return placed_shape
        heading = self.route.heading(self.route_time)
        return placed_shape._replace(rotation=placed_shape.rotation - cmath.phase(heading))

    @property
    def gains(self) -> Tuned:
        """The law's gains that all robots are to use."""
        gains = self._mission.gains
        return self.tuned or Tuned.model_construct(k_p=gains.k_p, k_i=gains.k_i)

    def _tune(self, request: OperatorRequest) -> tuple[bool, str]:
        wanted = intent.tuned(request, self.gains)
        why = intent.refusal(self._mission, request, gains=wanted) or self._turns_too_far(wanted)
        if why is not None:
            return False, why
        law, gains = self._mission.law, self._mission.gains
        self.tuned = None if (wanted.k_p, wanted.k_i) == (gains.k_p, gains.k_i) else wanted
        k_i = wanted.k_i if law.controller.integral else 0.0
        mu = spectrum.laplacian(self._mission.graph, mean=law.controller.mean)
        margin = spectrum.delay_margin(mu, wanted.k_p, k_i)
        return True, f"{wanted.words}; bears a delay of {margin * 1e3:.0f} ms"

    def _turns_too_far(self, gains: Tuned) -> str | None:
        """Why these gains are too high for the speed of the present route; None if they are not."""
        robot, limit = spectrum.greatest_leader_speed(self._mission, gains.k_p)
        speed = max((leg.speed for leg in self.route.legs), default=0.0)
        if speed < limit:
            return None
        why = f"{robot} turns too far between two commands behind a leader at {limit:.3g} m/s or more"
        return f"{gains.words}: {why}; the route is at {speed:g} m/s, order a lower speed first"

    def _change_shape(self, request: OperatorRequest) -> tuple[bool, str]:
        before = self.shape_transition.ordered
        placed_shape = intent.ordered_shape(request, self.wanted)
        shape = before.shape if request.shape is None else request.shape
        if placed_shape is None or shape not in self._mission.shapes:
            return False, intent.refusal(self._mission, request, self.wanted) or "no such shape"
        ordered = OrderedShape(shape, placed_shape.rotation, placed_shape.scale)
        path = self.shape_transition.plan_path(ordered, self._speed)
        if not self.shape_transition.fits_order(path):
            return False, f"still changing for {self.shape_transition.remaining:.1f} s: ask again then"
        placed_shapes = self.shape_transition.placed_shapes(path)
        why = intent.refusal(
            self._mission, request, self.wanted, placed_shapes, self.route.legs, place=self.where()
        ) or self._leaves_later(placed_shape)
        if why is not None:
            return False, why
        changes = ordered != before or not self.shape_transition.arrived
        self.shape_transition.follow(ordered, path)
        what = f"in shape {ordered.shape}"
        if request.do == "rotate":
            what = f"turned by {math.degrees(ordered.rotation):.4g}°"
        elif request.do == "scale":
            what = f"at scale {ordered.scale:.4g}"
        if not changes:
            return True, what
        running = "" if self.team_mode.mode == "run" else " of running"
        return True, f"{what} in {self.shape_transition.remaining:.1f} s{running}"

    def _leaves_later(self, placed_shape: PlacedShape) -> str | None:
        """Return why a shape would leave the bounds on the rest of a finite route; None if it would not."""
        if math.isinf(self.route.total):
            return None
        route, heading, since = self.route, self.route.heading(self.route_time), self.route_time
        before, _ = intent.leaves(self._fence, route, (self.wanted,), heading, since)
        why, _ = intent.leaves(self._fence, route, (placed_shape,), heading, since)
        return None if before else why

    @property
    def _speed(self) -> float:
        return self.route.max_speed(self.route_time, self.route_time)


def slots_of(placed_shape: PlacedShape) -> Slots:
    """Return a shape as in an order, rounded to 1e-7."""
    mix = {shape: min(round(share, 7), 1.0) for shape, share in placed_shape.mix if round(share, 7) > 0.0}
    return Slots(mix=mix, rotation=round(placed_shape.rotation, 7), scale=round(placed_shape.scale, 7))
