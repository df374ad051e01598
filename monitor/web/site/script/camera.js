/** The visible part of the plane, and its scale. World: metres, y up; screen: CSS pixels, y down. */

const SMALLEST = 2; // [px/m]
const LARGEST = 2000;
const EASE = 0.3; // share of the remaining change that one frame makes
const ROOM = 1.12; // the camera zooms in only if the formation could be drawn larger by this factor

export class Camera {
  constructor() {
    this.x = this.y = 0;
    this.scale = 60;
    this.width = this.height = 1;
    this.follows = true;
    this.placed = false;
  }

  resize(width, height) {
    if (width === this.width && height === this.height) return;
    this.width = width;
    this.height = height;
    if (this.follows) this.placed = false; // the next frame fits at once
  }

  sx(x) {
    return this.width / 2 + (x - this.x) * this.scale;
  }

  sy(y) {
    return this.height / 2 - (y - this.y) * this.scale;
  }

  /** The place [m] at the screen's (sx, sy). */
  place(sx, sy) {
    return [this.x + (sx - this.width / 2) / this.scale, this.y - (sy - this.height / 2) / this.scale];
  }

  sees({ x, y }) {
    const [sx, sy] = [this.sx(x), this.sy(y)];
    return sx > 0 && sx < this.width && sy > 0 && sy < this.height;
  }

  /** Centre the formation's `box` [m] in the canvas without its margins `room` [px]; `still`: at once. */
  follow(box, room, still) {
    if (!this.follows || !box) return;
    const wide = Math.max(box.right - box.left, 0.5);
    const high = Math.max(box.top - box.bottom, 0.5);
    const free = [this.width - 2 * room.side, this.height - room.top - room.bottom];
    const wanted = clamp(Math.min(free[0] / wide, free[1] / high));
    const ease = still || !this.placed ? 1 : EASE;
    if (!this.placed || wanted < this.scale || wanted > ROOM * this.scale) this.aim = wanted;
    this.x += ease * ((box.left + box.right) / 2 - this.x);
    this.scale += ease * ((this.aim ?? wanted) - this.scale);
    const down = (room.top - room.bottom) / 2 / this.scale;
    this.y += ease * ((box.bottom + box.top) / 2 + down - this.y);
    this.placed = true;
  }

  pan(dx, dy) {
    this.follows = false;
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** Zoom by `factor`; the point at the screen's (sx, sy) stays there. */
  zoom(factor, sx = this.width / 2, sy = this.height / 2) {
    const before = this.scale;
    this.follows = false;
    this.scale = clamp(before * factor);
    const change = 1 / before - 1 / this.scale;
    this.x += (sx - this.width / 2) * change;
    this.y -= (sy - this.height / 2) * change;
  }

  fit() {
    this.follows = true;
    this.placed = false;
  }
}

/** Bounding box of all robots and slots [m]; null while nothing is known. */
export function boxOf(robots) {
  const box = { left: Infinity, right: -Infinity, bottom: Infinity, top: -Infinity };
  const take = (x, y) => {
    box.left = Math.min(box.left, x);
    box.right = Math.max(box.right, x);
    box.bottom = Math.min(box.bottom, y);
    box.top = Math.max(box.top, y);
  };
  for (const robot of robots) {
    if (robot.place) take(robot.place.x, robot.place.y);
    if (robot.slot) take(robot.slot.x, robot.slot.y);
  }
  return box.left <= box.right ? box : null;
}

function clamp(scale) {
  return Math.min(LARGEST, Math.max(SMALLEST, scale));
}
