/** One robot's row of the table: state, commands with their limits, and health. */

import { make, setAttribute, setText } from "./dom.js";
import * as format from "./format.js";

/** Shares from which on a robot's health is good, and fair; below it is poor. */
const GOOD = 0.7, FAIR = 0.3;
const SYMBOLS = { run: "▶", hold: "Ⅱ", stop: "■", waiting: "…", lost: "✕", silent: "?", unseen: "?" };
const TONES = { run: "good", hold: "warn", stop: "bad", lost: "bad", waiting: "warn", silent: "warn" };

export class Row {
  constructor(robot, count, choose) {
    this.robot = robot;
    this.swatch = make("span", { class: "swatch", "aria-hidden": "true", "data-colour": swatch(robot, count) });
    this.name = make("button", { type: "button", class: "robot-name", "aria-pressed": "false" }, this.swatch, robot.name);
    this.name.addEventListener("click", () => choose(robot.name));
    this.name.title = robot.leader ? `${robot.name}, the leader` : robot.name;
    this.symbol = make("span", { class: "symbol", "aria-hidden": "true" });
    this.word = make("span");
    this.reason = make("span", { class: "reason" });
    this.state = make("span", { class: "state" }, this.symbol, this.word);
    this.bars = { speed: new Bar(2), turn_rate: new Bar(2) };
    this.health = make("span", { class: "health-share", role: "img" });
    this.cells = {};
    this.element = this.build();
  }

  build() {
    const name = make("th", { scope: "row", class: "name", role: "rowheader" }, this.name);
    const plain = (column) => {
      this.cells[column] = make("td", { class: `${column} figure`, role: "cell", "data-label": column });
      return this.cells[column];
    };
    const bar = (column, label) =>
      make("td", { class: column, role: "cell", "data-label": label }, this.bars[column].element);
    return make(
      "tr",
      { role: "row", "data-robot": this.robot.name },
      name,
      make("td", { class: "state", role: "cell" }, this.state, this.reason),
      plain("error"),
      bar("speed", "u"),
      bar("turn_rate", "ω"),
      plain("age"),
      plain("rate"),
      plain("loss"),
      make("td", { class: "health figure", role: "cell" }, this.health),
    );
  }

  update(chosen) {
    const { robot } = this;
    const word = robot.word;
    setText(this.word, word);
    setText(this.symbol, SYMBOLS[word] ?? "!");
    setAttribute(this.element, "data-lost", String(robot.lost));
    setAttribute(this.element, "data-tone", (robot.unavailable || robot.waits) && word === "run" ? "warn" : TONES[word] ?? "warn");
    const why = robot.remark || (word === "run" ? "" : robot.why);
    setText(this.reason, why);
    setAttribute(this.reason, "title", why);
    setAttribute(this.name, "aria-pressed", String(robot.name === chosen));
    setText(this.cells.error, robot.leader ? "leader" : format.length(robot.get("error")));
    setText(this.cells.age, format.age(robot.get("age")));
    setText(this.cells.rate, format.number(robot.get("rate"), 0, "Hz"));
    setText(this.cells.loss, format.share(robot.get("loss")));
    this.bars.speed.show(robot.command("speed"), "m/s");
    this.bars.turn_rate.show(robot.command("turn_rate"), "rad/s");
    this.showHealth();
  }

  showHealth() {
    const { health } = this.robot;
    const known = health !== null;
    const share = known ? `${Math.round(100 * health)} %` : "–";
    const text = known ? `health ${share}: ${this.robot.healthWhy || "all well"}` : "health not known";
    setText(this.health, share);
    setAttribute(this.health, "data-health", !known ? "unknown" : health >= GOOD ? "good" : health >= FAIR ? "fair" : "poor");
    setAttribute(this.health, "aria-label", text);
    setAttribute(this.health, "title", text);
  }

  matches(wanted) {
    const { robot } = this;
    return !wanted || `${robot.name} ${robot.word} ${robot.why} ${robot.remark}`.toLowerCase().includes(wanted);
  }
}

/** A command as a bar from the middle, with a mark at its limit. */
class Bar {
  constructor(digits) {
    this.digits = digits;
    this.text = make("span", { class: "bar-text" });
    this.fill = make("span", { class: "bar-fill" });
    this.mark = make("span", { class: "bar-mark" });
    this.element = make("span", { class: "bar" }, this.text, this.mark, make("span", { class: "bar-track" }, this.fill));
  }

  show({ value, share, limit, saturated }, unit) {
    setText(this.text, format.number(value, this.digits));
    setText(this.mark, saturated ? "max" : "");
    const full = Math.min(share ?? 0, 1) * Math.sign(value ?? 0);
    const transform = `scaleX(${full.toFixed(3)})`;
    if (this.transform !== transform) this.fill.style.transform = this.transform = transform;
    setAttribute(this.element, "data-saturated", String(saturated));
    const known = value === null ? "not known" : `${value.toFixed(2)} of at most ${limit} ${unit}`;
    setAttribute(this.element, "title", saturated ? `${known}: saturated` : known);
  }
}

function swatch(robot, count) {
  if (robot.leader) return "leader";
  return count <= 8 ? String(robot.index) : "all";
}
