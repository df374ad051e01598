/** What happened, newest first. */

import { byId, make, setHidden } from "./dom.js";
import * as format from "./format.js";

const SHOWN = 200;
const SYMBOLS = { 20: "•", 30: "▲", 40: "✖" };
const LEVELS = { 20: "information", 30: "warning", 40: "error" };

export class EventList {
  constructor(model) {
    this.model = model;
    this.list = byId("event-list");
    this.filter = byId("event-filter");
    this.grave = byId("event-grave");
    this.filter.addEventListener("input", () => this.rebuild());
    this.grave.addEventListener("change", () => this.rebuild());
  }

  rebuild() {
    const wanted = this.model.events.filter((event) => this.matches(event)).slice(-SHOWN);
    this.list.replaceChildren(...wanted.reverse().map(item));
    setHidden(byId("event-none"), wanted.length > 0);
  }

  add(event) {
    if (!this.matches(event)) return;
    this.list.prepend(item(event));
    while (this.list.childElementCount > SHOWN) this.list.lastElementChild.remove();
    setHidden(byId("event-none"), true);
  }

  matches(event) {
    const text = this.filter.value.trim().toLowerCase();
    if (this.grave.checked && event.level < 30) return false;
    return !text || `${event.robot} ${event.kind} ${event.text}`.toLowerCase().includes(text);
  }
}

function item(event) {
  const level = event.level >= 40 ? 40 : event.level >= 30 ? 30 : 20;
  const symbol = make("span", { class: "symbol", role: "img", "aria-label": LEVELS[level] }, SYMBOLS[level]);
  const time = make("time", { datetime: new Date(1000 * event.at).toISOString() }, format.clock(event.at));
  const text = event.robot && !event.text.startsWith(event.robot) ? `${event.robot}: ${event.text}` : event.text;
  const what = make("span", { class: "kind" }, event.kind);
  return make("li", { "data-level": String(level) }, time, symbol, what, make("span", { class: "text" }, text));
}
