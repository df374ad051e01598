/** The line to the monitor. It reconnects after every failure, and knows how long nothing has arrived. */

const SILENCE = 6000; // an open line that says nothing for so long is thought to be dead [ms] …
const LOOK = 500; // … which is looked at so often [ms]
const AGAIN = 1000; // between two attempts [ms]
const OLD = 1.5; // a server whose monitor hangs greets with the last frame it was given, so long ago [s]

export class Stream {
  /** `handlers` has a function for each kind of event: hello, frame, event; `begin` is called with each connection. */
  constructor(address, handlers, begin) {
    this.address = address;
    this.handlers = handlers;
    this.begin = begin;
    this.received = performance.now(); // when anything last came
    this.framed = null; // when a frame last came
    this.greeted = null; // what time it was there, until the first frame after that [s, the server's clock]
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
      if (old) return; // it is not what is now
      this.framed = this.received;
    }
    handle(data);
  }

  /** A browser gives up for good where the server answers wrongly, and waits for ever on a line that was cut. */
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
