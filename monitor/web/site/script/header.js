/** The header: state of the formation, of the recording and of the connection. */

import { byId, setAttribute, setHidden, setText } from "./dom.js";
import * as format from "./format.js";

const STALE = 1.5; // age from which on numbers are not called live [s]

export class Header {
  constructor(model, stream) {
    this.model = model;
    this.stream = stream;
    this.stale = false;
  }

  greet() {
    const { hello } = this.model;
    setText(byId("mission"), hello.mission);
    setText(byId("law"), `${hello.law} law`);
    document.title = `${hello.mission} – formation`;
    setText(byId("stale-word"), hello.live ? "✕ NOT LIVE." : "✕ THE REPLAY HAS STOPPED.");
    if (!hello.live) this.showPlayed(hello.recording);
    setText(byId("version"), hello.version ? `formation ${hello.version}` : "");
  }

  update() {
    const { frame, hello } = this.model;
    if (!frame) return;
    setText(byId("elapsed"), format.span(frame.elapsed));
    setText(byId("error"), error(frame));
    setText(byId("true-error"), besides(frame));
    const tone = frame.known ? "warn" : frame.error === null ? "bad" : frame.converged ? "good" : "plain";
    setAttribute(byId("error"), "data-tone", tone);
    byId("error").title = frame.known ? `over ${frame.known[3]}` : "";
    setText(byId("settled"), settled(frame, hello.settled));
    setText(byId("mode"), frame.mode ?? format.UNKNOWN);
    setText(byId("shape"), frame.shape ?? format.UNKNOWN);
    setText(byId("placed-shape"), placedShape(frame));
    setText(byId("bad-messages"), `${frame.missed} missed · ${frame.rejected} rejected`);
    if (hello.live) this.showRecording(frame.recording);
  }

  showRecording(recording) {
    const failure = recording?.failure ?? null;
    setHidden(byId("recording-failure"), failure === null);
    if (failure !== null) setText(byId("recording-failure-text"), failure);
    setAttribute(byId("recording"), "data-tone", failure !== null ? "bad" : recording ? "good" : "plain");
    setText(byId("recording"), recording ? `${failure === null ? "●" : "✖"} ${format.span(recording.seconds)}` : "off");
    setText(byId("recording-size"), recording ? (failure === null ? format.bytes(recording.bytes) : "NOT RECORDING") : "");
    byId("recording").title = recording?.path ?? "nothing is recorded";
  }

  /** Show the file that a replay plays. */
  showPlayed(path) {
    setText(byId("recording"), `▶ ${path ? path.split(/[\\/]/).pop() : "a recording"}`);
    setAttribute(byId("recording"), "data-tone", "plain");
    byId("recording").title = path ? `played: ${path}` : "";
  }

  /** Show whether the data is current. Called by a timer, as missing data causes no message. */
  watch() {
    const { age, open } = this.stream;
    const { replay } = this.model.frame ?? {};
    const stands = open && (replay?.paused || replay?.finished); // a paused replay does not get old
    const stale = age !== null && age > STALE && !stands;
    if (stale !== this.stale) {
      this.stale = stale;
      document.body.classList.toggle("stale", stale);
      setText(byId("stale-notice"), stale ? "No data is coming: what you see is old." : "Data is coming again.");
    }
    setHidden(byId("stale"), !stale);
    if (stale) setText(byId("stale-age"), `${age.toFixed(1)} s`);
    const state = this.state(stale);
    setText(byId("connection"), state.text);
    setAttribute(byId("connection"), "data-tone", state.tone);
  }

  state(stale) {
    const { replay } = this.model.frame ?? {};
    if (!this.stream.open) return { text: this.stream.age === null ? "◌ connecting …" : "✕ reconnecting …", tone: "bad" };
    if (stale) return { text: "✕ no data", tone: "bad" };
    if (this.stream.age === null) return { text: "◌ waiting for data", tone: "warn" };
    if (replay?.seeking) return { text: "… replay, seeking", tone: "warn" };
    if (replay?.finished) return { text: "■ replay, at its end", tone: "warn" };
    if (replay) return { text: replay.paused ? "Ⅱ replay, paused" : "▶ replay", tone: "warn" };
    return { text: "● live", tone: "good" };
  }
}

/** Rotation and scale of the shape. */
function placedShape({ rotation = 0, scale = 1 }) {
  const turned = rotation ? `${format.number((180 * rotation) / Math.PI, 0)}°` : "";
  const scaled = scale === 1 ? "" : `×${Number(scale.toPrecision(3))}`;
  return [turned, scaled].filter(Boolean).join(" ");
}

/** The error over the known edges; `besides` gives their number if some are unknown. */
function error(frame) {
  if (frame.known) return format.length(frame.known[0]);
  return frame.error === null ? "unknown" : format.length(frame.error);
}

function besides(frame) {
  if (frame.known) return `${frame.known[1]} of ${frame.known[2]} edges`;
  return frame.true === null ? "" : `true ${format.length(frame.true)}`;
}

function settled(frame, bound) {
  if (frame.forming) return "shape on its way";
  if (frame.known) {
    const [, some, all, , since] = frame.known;
    return since === null ? `not yet (< ${format.length(bound)})` : `${some} of ${all} since ${since.toFixed(1)} s`;
  }
  if (frame.settled_at === null) return `not yet (< ${format.length(bound)})`;
  if (frame.error === null) return `was, at ${frame.settled_at.toFixed(1)} s`; // before all robots were silent
  return frame.converged ? `at ${frame.settled_at.toFixed(1)} s` : `since ${frame.settled_at.toFixed(1)} s`;
}
