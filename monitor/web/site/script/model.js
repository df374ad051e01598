/** The data of the page, of bounded size: the newest frame, trails, the error over time, events. */

import { Robot } from "./robot.js";
import { Series } from "./ring.js";

const HISTORY = 2400; // values of the formation error: ten minutes
const HISTORY_STEP = 0.24; // time between two of them [s]
const EVENTS = 500;
const REWOUND = 0.5; // a frame older than the last one by this is of a replay that went back [s]

export class Model {
  constructor() {
    this.hello = null;
    this.frame = null;
    this.robots = [];
    this.edges = [];
    this.error = new Series(HISTORY, HISTORY_STEP);
    this.known = new Series(HISTORY, HISTORY_STEP); // over the known edges, while some are unknown
    this.events = [];
    this.chosen = null; // the robot that the operator looks at
    this.planned = []; // points of a route that is being drawn [m]
    this.frames = 0;
  }

  /** A connection begins: its data replaces all except the trails of the same robots. */
  greet(hello) {
    const same = this.hello && names(this.hello) === names(hello) && this.hello.mission === hello.mission;
    this.hello = hello;
    this.edges = hello.edges;
    if (!same) {
      const columns = new Map(hello.fields.map((name, index) => [name, index]));
      this.robots = hello.robots.map((spec, index) => new Robot(spec, index, columns));
      this.chosen = null;
      this.frame = null;
    }
    if (!hello.live) this.robots.forEach((robot) => robot.trail.clear()); // the replay jumped
    this.error.clear();
    this.known.clear();
    for (const [time, value] of hello.history) this.push(time, value, null);
    this.events = hello.events.slice(-EVENTS);
  }

  take(frame) {
    if (this.frame && frame.t < this.frame.t - REWOUND) this.rewind(frame.t);
    this.frame = frame;
    this.frames += 1;
    this.robots.forEach((robot, index) => robot.take(frame.r[index]));
    for (const robot of this.robots) if (robot.leader) robot.waits = frame.waits ?? "";
    this.push(frame.t, frame.error, frame.known?.[0] ?? null);
  }

  push(time, error, known) {
    this.error.push(time, error);
    this.known.push(time, known);
  }

  note(event) {
    const last = this.events[this.events.length - 1];
    if (last && event.n <= last.n) return; // repeated after a reconnection
    this.events.push(event);
    if (this.events.length > 1.2 * EVENTS) this.events.splice(0, this.events.length - EVENTS);
  }

  rewind(time) {
    this.error.rewind(time);
    this.known.rewind(time);
    this.events = this.events.filter((event) => event.at <= time);
    for (const robot of this.robots) robot.trail.clear();
  }

  /** When the formation's own time was 0 [s, the server's clock]. */
  get origin() {
    return this.frame ? this.frame.t - (this.frame.elapsed ?? 0) : 0;
  }

  choose(name) {
    this.chosen = this.chosen === name ? null : name;
  }
}

function names(hello) {
  return hello.robots.map((robot) => robot.name).join(" ");
}
