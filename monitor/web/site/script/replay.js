/** The controls of a replay: play and pause, speed, position. */

import { byId, make, setAttribute, setHidden, setText } from "./dom.js";
import * as format from "./format.js";

const LATE = 0.5; // additional playing time from which on it is shown [s]

export class ReplayBar {
  constructor(model) {
    this.model = model;
    this.slider = byId("replay-at");
    this.held = false; // whether the slider is being dragged
    this.asked = 0; // unanswered requests
    this.seeks = 0; // frames with fewer seeks are from before the last one
    byId("replay-play").addEventListener("click", () => this.toggle());
    byId("replay-speed").addEventListener("change", (event) => this.request("speed", Number(event.target.value)));
    this.slider.addEventListener("input", () => {
      this.held = true;
      this.showTime(Number(this.slider.value));
    });
    this.slider.addEventListener("change", () => {
      this.held = false;
      this.request("seek", this.now.start + Number(this.slider.value));
    });
  }

  get now() {
    return this.model.frame?.replay ?? null;
  }

  get stands() {
    return this.now.paused || this.now.finished === true;
  }

  /** A connection begins, perhaps to another replay, which counts its seeks from 0. */
  begin() {
    this.seeks = 0;
  }

  greet() {
    setHidden(byId("replay"), this.model.hello.live);
  }

  toggle() {
    if (this.now) this.request(this.stands ? "play" : "pause");
  }

  async request(what, to) {
    const body = JSON.stringify(to === undefined ? { do: what } : { do: what, to });
    this.asked += 1;
    const answer = await fetch("api/replay", { method: "POST", headers: { "Content-Type": "application/json" }, body })
      .catch(() => null);
    const state = answer?.ok ? await answer.json().catch(() => null) : null;
    this.asked -= 1;
    this.seeks = Math.max(this.seeks, state?.seeks ?? 0); // answers may overtake each other
    setText(byId("replay-notice"), answer?.ok ? "" : `${what}: not obeyed`);
  }

  update() {
    const { now } = this;
    if (!now) return;
    const whole = now.end - now.start;
    setAttribute(this.slider, "max", whole.toFixed(1));
    setText(byId("replay-play"), this.stands ? "▶ Play" : "Ⅱ Pause");
    this.showSpeed(now.speed);
    setAttribute(byId("replay"), "aria-busy", String(now.seeking === true));
    setText(byId("replay-remarks"), remarks(now));
    if (this.held || this.asked || now.seeks < this.seeks) return;
    this.slider.value = (now.t - now.start).toFixed(1);
    this.showTime(now.t - now.start);
  }

  /** Show the speed; add one that the command line requested and the list lacks. */
  showSpeed(speed) {
    const choice = byId("replay-speed");
    if (document.activeElement === choice || choice.value === String(speed)) return;
    if (![...choice.options].some((option) => option.value === String(speed))) {
      choice.append(make("option", { value: String(speed) }, `${speed} ×`));
    }
    choice.value = String(speed);
  }

  showTime(seconds) {
    const text = `${format.span(seconds)} of ${format.span(this.now ? this.now.end - this.now.start : null)}`;
    setText(byId("replay-time"), text);
    setAttribute(this.slider, "aria-valuetext", text);
  }
}

/** Remarks on unexpected states, as in the terminal. */
function remarks({ start, counted_from: counted, drift, skipped }) {
  const found = [];
  if (counted > start) found.push(`settling, elapsed time and counts since ${format.span(counted - start)} only`);
  if (drift > LATE) found.push(`${drift.toFixed(1)} s late`);
  if (skipped > 0) found.push(`${skipped} messages came too late to be published`);
  return found.length ? `▲ ${found.join(" · ")}` : "";
}
