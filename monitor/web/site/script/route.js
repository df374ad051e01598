/** A route for the leader through points tapped on the map. */

import { byId, setAttribute, setHidden, setText } from "./dom.js";

const MOST = 50; // most points of one route
const SHARE = 0.5; // proposed speed, as a share of the slowest robot's limit

export class RouteOrder {
  constructor(model, view, orders) {
    this.model = model;
    this.view = view;
    this.orders = orders;
    this.speed = byId("route-speed");
    byId("route-open").addEventListener("click", () => this.open(view.onPlace === null));
    byId("route-go").addEventListener("click", () => this.go());
    byId("route-back").addEventListener("click", () => this.show(this.points.slice(0, -1)));
    this.show([]);
  }

  greet() {
    const limits = this.model.hello.robots.filter((robot) => !robot.leader).map((robot) => robot.max_speed);
    if (!this.speed.value && limits.length) this.speed.value = Number((SHARE * Math.min(...limits)).toPrecision(2));
  }

  open(wanted) {
    this.view.onPlace = wanted ? (x, y) => this.show([...this.points, [x, y]].slice(0, MOST)) : null;
    setAttribute(byId("route-open"), "aria-pressed", String(wanted));
    setHidden(byId("route-parts"), !wanted);
    this.show([]);
  }

  show(points) {
    this.points = points;
    this.model.planned = points;
    const text = points.length ? `Go along ${points.length} point${points.length > 1 ? "s" : ""}` : "Tap points on the map";
    setText(byId("route-go"), text);
    byId("route-go").disabled = !points.length;
    byId("route-back").disabled = !points.length;
    this.view.draw();
  }

  go() {
    const waypoints = this.points.map(([x, y]) => [Number(x.toFixed(3)), Number(y.toFixed(3))]);
    this.orders.give("route", { legs: [{ waypoints, speed: Number(this.speed.value) }] });
    this.open(false);
  }
}
