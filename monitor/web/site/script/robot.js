/** One robot as the newest frame has it, and where it was when last known. */

import { Trail } from "./ring.js";

const LOST = 1.0; // a position older than this is no position [s]
const POINTS = 900; // of a trail …
const STEP = 0.03; // … which has one every so many metres
const FULL = 0.995; // of its limit: the command is saturated

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

  /** A figure of the newest frame; null where it is not known now. */
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

  /** What it is doing, in one word. */
  get word() {
    if (this.lost) return "lost";
    return this.state;
  }

  get why() {
    const reason = this.get("reason") ?? "";
    return this.lost ? `no position for ${this.get("age").toFixed(1)}\u00a0s` : reason;
  }

  /** It says that it is unavailable: its dependants go on without it. */
  get unavailable() {
    return !this.lost && Boolean(this.get("unavailable"));
  }

  /** What is out of the ordinary although it runs. */
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

  /** Where it really is, if that is known (simulated robots). */
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

  /** How badly it needs to be looked at: the larger the worse. */
  get trouble() {
    if (!this.seen) return 5e3;
    if (this.lost) return 4e3 + Math.min(this.get("age"), 900);
    const stopped = { run: 0, hold: 1e3, waiting: 1.5e3, stop: 2e3 }[this.state] ?? 2.5e3;
    return stopped + (this.unavailable ? 800 : 0) + 500 * (1 - (this.health ?? 1)) + Math.min(this.get("error") ?? 0, 100);
  }
}
