/** Lists of bounded length. */

/** The newest points of a path, in memory of fixed size. */
export class Trail {
  constructor(capacity) {
    this.points = new Float32Array(2 * capacity);
    this.capacity = capacity;
    this.clear();
  }

  clear() {
    this.length = 0;
    this.next = 0;
  }

  push(x, y) {
    this.points[2 * this.next] = x;
    this.points[2 * this.next + 1] = y;
    this.next = (this.next + 1) % this.capacity;
    this.length = Math.min(this.length + 1, this.capacity);
  }

  /** Distance [m] from the newest point; infinite while there is none. */
  from(x, y) {
    if (!this.length) return Infinity;
    const last = (this.next + this.capacity - 1) % this.capacity;
    return Math.hypot(x - this.points[2 * last], y - this.points[2 * last + 1]);
  }

  /** Call `see(x, y)` for every point, oldest first. */
  each(see) {
    const first = (this.next + this.capacity - this.length) % this.capacity;
    for (let n = 0; n < this.length; n += 1) {
      const at = 2 * ((first + n) % this.capacity);
      see(this.points[at], this.points[at + 1]);
    }
  }
}

/** One value over time, at most every `step` seconds, for `capacity` values. */
export class Series {
  constructor(capacity, step) {
    this.capacity = capacity;
    this.step = step;
    this.clear();
  }

  clear() {
    this.times = [];
    this.values = [];
  }

  get last() {
    return this.times.length ? this.times[this.times.length - 1] : -Infinity;
  }

  push(time, value) {
    if (time < this.last + this.step) return;
    this.times.push(time);
    this.values.push(value);
    // Now and then, not for each value: an array is shortened from its front by copying it.
    if (this.times.length > 1.2 * this.capacity) this.forget(this.times.length - this.capacity);
  }

  forget(count) {
    this.times.splice(0, count);
    this.values.splice(0, count);
  }

  /** Forget what is later than `time`, as when a replay goes back. */
  rewind(time) {
    while (this.last > time) {
      this.times.pop();
      this.values.pop();
    }
  }
}
