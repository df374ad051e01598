/** One robot in the newest frame, and its last known place. */

import { Trail } from "./ring.js";

const LOST = 1.0; // age of a position from which on the robot is lost [s]
const POINTS = 900; // points of a trail
const STEP = 0.03; // distance between them [m]
const FULL = 0.995; // share of the limit from which on a command is saturated

export class Robot {
  constructor(spec, index, columns) {
    this.name = spec.name;
    this.leader = spec.leader;
    this.spec = spec;
    this.index = index;
    this.columns = columns;
    this.row = [];
    this.place = null; // the last known one
    this.waits = ""; // names of the robots that the leader waits for
    this.trail = new Trail(POINTS);
  }

  take(row) {
    this.row = row ?? [];
    const [x, y, heading] = [this.get("x"), this.get("y"), this.get("heading")];
    if (x === null || y === null) return;
    this.place = { x, y, heading: heading ?? 0, px: this.get("point_x") ?? x, py: this.get("point_y") ?? y };
    if (this.trail.from(x, y) > STEP) this.trail.push(x, y);
  }

  /** A value of the newest frame; null if it is unknown. */
  get(column) {
    return this.row[this.columns.get(column)] ?? null;
  }

  get state() {
    return this.get("state") ?? "unseen";
  }

  get seen() {
    return this.get("age") !== null;
  }

  get lost() {
    return this.seen && this.get("age") > LOST;
  }

  /** Its state in one word. */
  get word() {
    if (this.lost) return "lost";
    return this.state;
  }

  get why() {
    const reason = this.get("reason") ?? "";
    return this.lost ? `no position for ${this.get("age").toFixed(1)}\u00a0s` : reason;
  }

  /** Whether it reports that it is unavailable: its dependants go on without it. */
  get unavailable() {
    return !this.lost && Boolean(this.get("unavailable"));
  }

  /** Remark on a robot that runs. */
  get remark() {
    const fallback = this.get("fallback");
    if (this.waits) return `waits for ${this.waits}`;
    if (this.get("unavailable") === 2 && !this.lost) return "stuck, does not move";
    if (this.unavailable) return "unavailable";
    const avoiding = this.lost ? "" : this.get("avoiding");
    return avoiding || (fallback ? `follows ${fallback} instead` : "");
  }

  get slot() {
    const [x, y] = [this.get("slot_x"), this.get("slot_y")];
    return x === null || y === null ? null : { x, y };
  }

  /** True pose, if known (simulated robots). */
  get truth() {
    const [x, y] = [this.get("true_x"), this.get("true_y")];
    if (x === null || y === null || !this.place) return null;
    return { x, y, heading: this.place.heading - (this.get("heading_error") ?? 0) };
  }

  get healthWhy() {
    return this.lost ? this.why : this.get("health_why") ?? "";
  }

  get health() {
    return this.lost ? 0 : this.get("health");
  }

  /** u or ω: its value, its share of the limit, and whether it is at the limit. */
  command(which) {
    const [value, share] = [this.get(which), this.get(`${which}_share`)];
    const limit = which === "speed" ? this.spec.max_speed : this.spec.max_turn_rate;
    return { value, share, limit, saturated: share !== null && share >= FULL };
  }

  /** Urgency for sorting; the largest first. */
  get trouble() {
    if (!this.seen) return 5e3;
    if (this.lost) return 4e3 + Math.min(this.get("age"), 900);
    const stopped = { run: 0, hold: 1e3, waiting: 1.5e3, stop: 2e3 }[this.state] ?? 2.5e3;
    return stopped + (this.unavailable ? 800 : 0) + 500 * (1 - (this.health ?? 1)) + Math.min(this.get("error") ?? 0, 100);
  }
}
