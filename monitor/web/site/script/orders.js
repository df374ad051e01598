/** Orders to the fleet, and the robots' answers. Shown only if the monitor runs with --control. */

import { byId, make, setAttribute, setHidden, setText } from "./dom.js";
import { forget, keep, post, randomId, token } from "./token.js";

const TWICE = 1000; // longest time between two presses of Escape that stop [ms]
const ARMED = 4000; // longest time until the second press of an order that may start robots [ms]
const PATIENCE = 5000; // longest wait for an answer of the page's own server [ms]
const RESTS = new Set(["stop", "hold"]);

export class Orders {
  constructor(model) {
    this.model = model;
    this.escaped = -Infinity;
    this.armed = null;
    this.turn = 0; // of the newest order
    this.shown = 0; // of the newest order with a result on the page
    this.shape = byId("order-shape");
    for (const button of document.querySelectorAll("button[data-do]")) {
      button.addEventListener("click", (event) => this.press(button, event.detail > 1));
    }
    byId("token-form").addEventListener("submit", (event) => this.enter(event));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  get allowed() {
    return this.model.hello?.control === true;
  }

  greet() {
    setHidden(byId("orders"), !this.allowed);
    if (!this.allowed) return;
    const shapes = Object.keys(this.model.hello.shapes);
    const chosen = this.shape.value;
    this.shape.replaceChildren(...shapes.map((name) => make("option", { value: name }, name)));
    if (shapes.includes(chosen)) this.shape.value = chosen;
    setHidden(this.shape.parentElement, shapes.length < 2);
    this.showToken();
    this.check();
  }

  showToken(wrong = false) {
    setHidden(byId("token-form"), token() !== "");
    setHidden(byId("order-buttons"), token() === "");
    for (const part of ["route", "drive"]) setHidden(byId(part), token() === "");
    setHidden(byId("token-wrong"), !wrong);
  }

  enter(event) {
    event.preventDefault();
    keep(byId("token").value);
    byId("token").value = "";
    this.showToken();
    if (token()) document.querySelector('button[data-do="stop"]').focus();
    this.check();
  }

  /** Check the token before it is needed for a stop: a restarted monitor has another one. */
  async check() {
    const sent = token();
    if (!sent) return;
    const headers = { Authorization: `Bearer ${sent}` };
    const answer = await fetch("api/order", { headers, signal: AbortSignal.timeout(PATIENCE) }).catch(() => null);
    if (answer?.status !== 401 || token() !== sent) return;
    forget();
    this.showToken(true);
  }

  /** Escape twice stops. */
  key(event) {
    if (event.key !== "Escape" || event.repeat || !this.allowed) return;
    const now = performance.now();
    if (now - this.escaped < TWICE) this.give("stop");
    this.escaped = now - this.escaped < TWICE ? -Infinity : now;
  }

  /** Give stop and hold at once; other orders at a second press, which is no double click. */
  press(button, hasty = false) {
    const what = button.dataset.do;
    if (hasty && this.armed === button) return;
    if (RESTS.has(what) || this.armed === button) {
      this.disarm();
      this.give(what);
      return;
    }
    this.disarm();
    this.armed = button;
    button.classList.add("armed");
    setText(button.querySelector(".again"), "press again");
    this.timer = setTimeout(() => this.disarm(), ARMED);
  }

  disarm() {
    clearTimeout(this.timer);
    if (!this.armed) return;
    this.armed.classList.remove("armed");
    setText(this.armed.querySelector(".again"), "");
    this.armed = null;
  }

  async give(what, values = {}) {
    const seen = this.model.frame?.t ?? 0; // stop and hold are allowed before the first frame
    const body = { do: what, click: randomId(12), seen, ...values }; // a click that is sent twice counts once
    if (what === "shape") body.shape = this.shape.value;
    const turn = (this.turn += 1);
    this.tell("asking", `${what}: asking …`);
    try {
      const answer = await post("api/order", body, PATIENCE);
      const reply = await answer.json().catch(() => ({}));
      this.receive(turn, what, answer, reply);
    } catch (error) {
      const text = error.name === "TimeoutError" ? "NO ANSWER from the monitor" : "NOT SENT, the monitor cannot be reached";
      this.result(turn, what, "bad", `${what}: ${text}. Use the emergency stop on the robots.`);
    }
  }

  receive(turn, what, answer, reply) {
    if (answer.status === 401) {
      forget();
      this.showToken(true);
      this.result(turn, what, "bad", `${what}: REFUSED, the token is not right`);
      return;
    }
    if (!answer.ok) this.result(turn, what, "bad", `${what}: REFUSED, ${reply.error ?? `answer ${answer.status}`}`);
    else this.acknowledge(turn, what, reply);
  }

  /** List robots without an answer, then those that refused with the reason, then those that obeyed with the time. */
  acknowledge(turn, what, { acknowledged, refused, missing, why, advice = [], unreached = [] }) {
    const sound = !refused.length && !missing.length;
    const sum = `${what}: ${acknowledged.length} of ${acknowledged.length + refused.length + missing.length} obey`;
    const slowest = Math.max(0, ...acknowledged.map((one) => one.ms));
    const text = sound ? `${sum}, the slowest after ${slowest.toFixed(0)} ms` : sum;
    const items = [
      ...(why ? [make("li", { "data-tone": "warn" }, why)] : []),
      ...advice.map((text) => make("li", { "data-tone": sound ? "good" : "warn" }, text)),
      ...missing.map((name) => make("li", { "data-tone": "bad" }, `✕ ${name} NO ANSWER`)),
      ...refused.map((one) => make("li", { "data-tone": "bad" }, `✕ ${one.robot} ${verdict(what, one, unreached)}: ${one.reason}`)),
      ...acknowledged.map((one) => make("li", { "data-tone": "good" }, `✓ ${one.robot} ${one.mode} ${one.ms.toFixed(0)} ms`)),
    ];
    this.result(turn, what, sound ? "good" : "bad", text, items);
  }

  /** Show a result; that of an older stop or hold goes below the newer one. */
  result(turn, what, tone, text, items = []) {
    if (turn !== this.turn && !RESTS.has(what)) return;
    if (turn < this.shown) {
      byId("acknowledgements").append(make("li", { "data-tone": tone }, text), ...items);
      return;
    }
    this.shown = turn;
    this.tell(tone, text);
    byId("acknowledgements").append(...items);
  }

  tell(tone, text) {
    byId("acknowledgements").replaceChildren();
    setAttribute(byId("order-result"), "data-tone", tone);
    setText(byId("order-result"), text);
  }
}

/** The agent has latched a stop or a hold, but cannot reach its robot. */
function verdict(what, one, unreached) {
  if (!unreached.includes(one.robot)) return "REFUSED";
  return what === "stop" ? "NOT STOPPED" : "NOT HELD";
}
