/** Drive the leader by hand with a pad. When it is released, all robots hold. */

import { byId, setAttribute, setHidden, setText } from "./dom.js";
import { post, randomId } from "./token.js";

const PERIOD = 50; // between two velocities [ms]
const PATIENCE = 300; // longest wait for an answer; the leader uses a velocity no longer than that [ms]
const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };

export class DrivePad {
  constructor() {
    this.pad = byId("drive-pad");
    this.driver = `page-${randomId(6)}`;
    this.leaders = 0; // token of the leader's newest answer
    this.wanted = [0, 0];
    this.held = new Set();
    this.driving = false;
    byId("drive-open").addEventListener("click", () => this.open());
    this.pad.addEventListener("pointerdown", (event) => this.grip(event));
    this.pad.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "contextmenu", "blur"]) {
      this.pad.addEventListener(kind, () => this.release());
    }
    this.pad.addEventListener("keydown", (event) => this.key(event, true));
    this.pad.addEventListener("keyup", (event) => this.key(event, false));
    window.addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => this.release());
  }

  open() {
    const shown = this.pad.hidden;
    setHidden(this.pad, !shown);
    setAttribute(byId("drive-open"), "aria-expanded", String(shown));
    this.release();
    if (shown) this.pad.focus();
    setText(byId("drive-state"), shown ? "drag the knob, or hold arrow keys; let go and all robots hold" : "");
  }

  grip(event) {
    if (event.button !== 0) return;
    this.pad.setPointerCapture(event.pointerId);
    this.gripped = event.pointerId;
    this.move(event);
    this.drive();
  }

  move(event) {
    if (this.gripped !== event.pointerId) return;
    if (!event.buttons) return this.release(); // it was released outside the page
    const box = this.pad.getBoundingClientRect();
    const x = (2 * (event.clientX - box.left)) / box.width - 1;
    const y = (2 * (event.clientY - box.top)) / box.height - 1;
    const length = Math.max(1, Math.hypot(x, y));
    this.show([-y / length, -x / length]);
  }

  key(event, down) {
    if (event.key === "Meta" || event.metaKey) return this.release(); // browsers report no key release beside it
    if (!KEYS[event.key]) return;
    event.preventDefault();
    if (down) this.held.add(event.key);
    else this.held.delete(event.key);
    const sum = [...this.held].reduce(([f, t], key) => [f + KEYS[key][0], t + KEYS[key][1]], [0, 0]);
    this.show(sum);
    if (this.held.size) this.drive();
  }

  release() {
    this.gripped = null;
    this.held.clear();
    this.show([0, 0]);
  }

  show(wanted) {
    this.wanted = wanted;
    setAttribute(this.pad, "data-held", String(wanted[0] !== 0 || wanted[1] !== 0));
    byId("drive-knob").style.transform = `translate(${-2.7 * wanted[1]}rem, ${-2.7 * wanted[0]}rem)`;
  }

  get released() {
    return this.wanted[0] === 0 && this.wanted[1] === 0 && this.gripped == null && !this.held.size;
  }

  /** Send a velocity each period while the pad is held, and zero once at its end; one at a time. */
  async drive() {
    if (this.driving) return;
    this.driving = true;
    let last = false;
    while (!last || !this.released) { // it may be gripped again while the zero is on its way
      last = this.released;
      const next = new Promise((done) => setTimeout(done, PERIOD));
      await this.send(this.wanted);
      await next;
    }
    this.driving = false;
  }

  async send([forward, turn]) {
    const body = { forward, turn, token: this.leaders, driver: this.driver };
    try {
      const answer = await post("api/drive", body, PATIENCE);
      const reply = await answer.json();
      if (!answer.ok) return this.tell("bad", `REFUSED: ${reply.error}`);
      this.leaders = reply.token;
      const stands = forward === 0 && turn === 0;
      if (reply.ok || reply.code === "first") this.tell("good", stands ? "let go: all robots hold" : "driving");
      else this.tell("bad", `the leader does not obey: ${reply.reason}`);
    } catch {
      this.tell("bad", "no answer: the leader holds all robots");
    }
  }

  tell(tone, text) {
    setAttribute(byId("drive-state"), "data-tone", tone);
    setText(byId("drive-state"), text);
  }
}
