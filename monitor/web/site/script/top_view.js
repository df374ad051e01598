/** The top view, moved by mouse, finger and keyboard; it follows the formation unless switched off. */

import { Camera, boxOf } from "./camera.js";
import { draw } from "./drawing.js";

const STEP = 60; // distance of one press of an arrow [px]
const NEARER = 1.25; // zoom of one press of plus
const TAP = 6; // largest motion of a tap [px]
const REACH = 24; // largest distance of a tap from its robot [px]

export class TopView {
  constructor(model, { canvas, follow, nearer, farther }, choose) {
    this.model = model;
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.camera = new Camera();
    this.followButton = follow;
    this.choose = choose;
    this.pointers = new Map();
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.requested = false;
    this.onPlace = null; // called with a tapped place [m], instead of choosing a robot
    this.listen(nearer, farther);
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  listen(nearer, farther) {
    const { canvas, camera } = this;
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(kind, (event) => this.lift(event));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.change(() => camera.zoom(Math.exp(-0.0015 * event.deltaY), event.offsetX, event.offsetY));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.change(() => camera.fit()));
    canvas.addEventListener("keydown", (event) => this.key(event));
    this.followButton.addEventListener("click", () => this.change(() => this.toggle()));
    nearer.addEventListener("click", () => this.change(() => camera.zoom(NEARER)));
    farther.addEventListener("click", () => this.change(() => camera.zoom(1 / NEARER)));
  }

  toggle() {
    if (this.camera.follows) this.camera.follows = false;
    else this.camera.fit();
  }

  change(act) {
    act();
    this.followButton.setAttribute("aria-pressed", String(this.camera.follows));
    this.draw();
  }

  key(event) {
    const { camera } = this;
    const acts = {
      ArrowLeft: () => camera.pan(STEP, 0),
      ArrowRight: () => camera.pan(-STEP, 0),
      ArrowUp: () => camera.pan(0, STEP),
      ArrowDown: () => camera.pan(0, -STEP),
      "+": () => camera.zoom(NEARER),
      "=": () => camera.zoom(NEARER),
      "-": () => camera.zoom(1 / NEARER),
      0: () => camera.fit(),
      Home: () => camera.fit(),
    };
    if (!acts[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.change(acts[event.key]);
  }

  press(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY, moved: 0 });
  }

  /** Pan with one pointer, zoom with two. */
  move(event) {
    const one = this.pointers.get(event.pointerId);
    if (!one) return;
    const [dx, dy] = [event.offsetX - one.x, event.offsetY - one.y];
    const before = this.spread();
    one.x = event.offsetX;
    one.y = event.offsetY;
    one.moved += Math.hypot(dx, dy);
    if (one.moved < TAP) return;
    this.change(() => {
      this.camera.pan(dx / this.pointers.size, dy / this.pointers.size);
      const after = this.spread();
      if (before && after) this.camera.zoom(after.far / before.far, after.x, after.y);
    });
  }

  spread() {
    if (this.pointers.size !== 2) return null;
    const [a, b] = this.pointers.values();
    return { far: Math.max(Math.hypot(a.x - b.x, a.y - b.y), 1), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
  }

  lift(event) {
    const one = this.pointers.get(event.pointerId);
    this.pointers.delete(event.pointerId);
    if (one && one.moved < TAP && event.type === "pointerup") this.tap(one.x, one.y);
  }

  tap(x, y) {
    if (this.onPlace) {
      this.onPlace(...this.camera.place(x, y));
      return;
    }
    const far = (robot) => Math.hypot(this.camera.sx(robot.place.x) - x, this.camera.sy(robot.place.y) - y);
    const near = this.model.robots
      .filter((robot) => robot.place && far(robot) < REACH)
      .sort((a, b) => far(a) - far(b));
    if (near.length) this.choose(near[0].name);
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    const dots = Math.min(devicePixelRatio || 1, 3);
    this.canvas.width = Math.max(1, Math.round(clientWidth * dots));
    this.canvas.height = Math.max(1, Math.round(clientHeight * dots));
    this.pen.setTransform(dots, 0, 0, dots, 0, 0);
    this.camera.resize(Math.max(1, clientWidth), Math.max(1, clientHeight));
    this.draw();
  }

  /** Draw once with the browser's next picture. */
  draw() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.paint();
    });
  }

  paint() {
    const unit = parseFloat(getComputedStyle(document.documentElement).fontSize) / 16;
    if (!this.model.frame) return;
    const side = Math.min(56 * unit, 0.14 * this.camera.width);
    const room = { side, top: 62 * unit, bottom: 46 * unit }; // buttons above, names and scale below
    this.camera.follow(boxOf(this.model.robots), room, this.still.matches);
    draw(this.pen, this.camera, this.model, unit);
  }
}
