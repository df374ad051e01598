/** The connection to the monitor. It reconnects after every failure, and measures the age of data. */

const SILENCE = 6000; // time without data after which a connection counts as dead [ms]
const LOOK = 500; // time between two checks of that [ms]
const AGAIN = 1000; // time between two attempts [ms]
const OLD = 1.5; // age of a first frame from which on it is not shown: the monitor hangs [s]

export class Stream {
  /** `handlers` has a function for each kind of event: hello, frame, event; `begin` is called with each connection. */
  constructor(address, handlers, begin) {
    this.address = address;
    this.handlers = handlers;
    this.begin = begin;
    this.received = performance.now(); // when anything last came
    this.framed = null; // when a frame last came
    this.greeted = null; // time of the greeting, until the first frame after it [s, the server's clock]
    this.dialled = -Infinity;
    this.open = false;
    this.source = null;
    this.dial();
    setInterval(() => this.watch(), LOOK);
  }

  dial() {
    this.hangUp();
    this.dialled = this.received = performance.now();
    this.source = new EventSource(this.address);
    this.source.onopen = this.begin;
    this.source.onerror = () => {
      this.open = false;
    };
    for (const [kind, handle] of Object.entries(this.handlers)) {
      this.source.addEventListener(kind, (message) => this.receive(kind, handle, message));
    }
  }

  hangUp() {
    this.open = false;
    if (this.source) this.source.close();
  }

  receive(kind, handle, message) {
    this.received = performance.now();
    this.open = true;
    const data = JSON.parse(message.data);
    if (kind === "hello") this.greeted = data.live ? data.now : null;
    if (kind === "frame") {
      const old = this.greeted !== null && this.greeted - data.t > OLD;
      this.greeted = null;
      if (old) return; // not current
      this.framed = this.received;
    }
    handle(data);
  }

  /** Reconnect where a browser would not: after a wrong answer, and on a connection that was cut. */
  watch() {
    const now = performance.now();
    const closed = this.source.readyState === EventSource.CLOSED;
    const dead = now - this.received > SILENCE;
    if ((closed || dead) && now - this.dialled > AGAIN) this.dial();
  }

  /** Age of the newest frame [s]; null before the first. */
  get age() {
    return this.framed === null ? null : (performance.now() - this.framed) / 1000;
  }
}
