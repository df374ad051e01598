/** The list of events, newest first. */

import { lines, sum } from "./bursts.js";
import { byId, make, setHidden } from "./dom.js";
import * as format from "./format.js";

const SHOWN = 200; // lines
const SYMBOLS = { 20: "•", 30: "▲", 40: "✖" };
const LEVELS = { 20: "information", 30: "warning", 40: "error" };

export class EventList {
  constructor(model) {
    this.model = model;
    this.list = byId("event-list");
    this.filter = byId("event-filter");
    this.warnings = byId("event-warnings");
    this.shown = new Map(); // items by their events
    this.outdated = false;
    this.filter.addEventListener("input", () => this.show());
    this.warnings.addEventListener("change", () => this.show());
  }

  /** Show other events, as after a jump in a replay. */
  rebuild() {
    this.list.replaceChildren();
    this.shown.clear();
    this.show();
  }

  add() {
    this.outdated = true;
  }

  update() {
    if (this.outdated) this.show();
  }

  /** Update the list; items that stay are not touched, or a screen reader would read them again. */
  show() {
    this.outdated = false;
    const wanted = lines(this.model.events.filter((event) => this.matches(event))).slice(0, SHOWN);
    const opened = this.opened();
    this.keepOnly(new Set(wanted.map(name)));
    let next = this.list.firstElementChild;
    for (const events of wanted) {
      const known = this.shown.get(name(events));
      if (known && known === next) next = next.nextElementSibling;
      else this.list.insertBefore(known ?? this.item(events, opened), next);
    }
    setHidden(byId("event-none"), wanted.length > 0);
  }

  /** First numbers of the lines that are open. */
  opened() {
    return new Set([...this.list.querySelectorAll("details[open]")].map((one) => one.dataset.first));
  }

  keepOnly(wanted) {
    for (const [key, element] of this.shown) {
      if (wanted.has(key)) continue;
      element.remove();
      this.shown.delete(key);
    }
  }

  item(events, opened) {
    const element = item(events, opened.has(String(events[0].n)));
    this.shown.set(name(events), element);
    return element;
  }

  matches(event) {
    const text = this.filter.value.trim().toLowerCase();
    if (this.warnings.checked && event.level < 30) return false;
    return !text || `${event.robot} ${event.kind} ${event.text}`.toLowerCase().includes(text);
  }
}

/** Key of a line; a burst that grows gets another. */
function name(events) {
  return `${events[0].n} ${events[events.length - 1].n} ${events.length}`;
}

function item(events, open) {
  const [event] = events;
  const level = event.level >= 40 ? 40 : event.level >= 30 ? 30 : 20;
  const symbol = make("span", { class: "symbol", role: "img", "aria-label": LEVELS[level] }, SYMBOLS[level]);
  const time = make("time", { datetime: new Date(1000 * event.at).toISOString() }, format.clock(event.at));
  const what = make("span", { class: "kind" }, event.kind);
  const text = events.length > 1 ? many(events, open) : make("span", { class: "text" }, one(event));
  return make("li", { "data-level": String(level) }, time, symbol, what, text);
}

function one(event) {
  return event.robot && !event.text.startsWith(event.robot) ? `${event.robot}: ${event.text}` : event.text;
}

function many(events, open) {
  const each = make("ul", {}, ...events.map((event) => make("li", {}, one(event))));
  const first = String(events[0].n);
  const whole = make("details", { class: "text", "data-first": first }, make("summary", {}, sum(events)), each);
  whole.open = open;
  return whole;
}
