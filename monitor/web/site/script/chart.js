/** The formation error over time, with the mission's bound and the events. */

import { byId, setAttribute, setHidden, setText } from "./dom.js";
import * as format from "./format.js";
import { colour } from "./palette.js";
import { restore, store } from "./store.js";

const LEAST = 1e-4; // where a logarithmic scale ends below [m]
const SYMBOLS = { lost: "✕", stopped: "■", held: "Ⅱ", runs: "▶", back: "↩", settled: "✓", unsettled: "✓̸", order: "◆", operator: "◆", leader: "★", recording: "●" };
const APART = 13; // least distance between two symbols; others are left out [px]
const SECONDS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 3600]; // between two marks of the time
const KEY = "formation-log-scale";

export class ErrorChart {
  constructor(model, host) {
    this.model = model;
    this.host = host;
    this.plot = null;
    this.logarithmic = restore("localStorage", KEY) !== "no";
    this.button = byId("log-scale");
    this.button.addEventListener("click", () => this.toggle());
    setAttribute(this.button, "aria-pressed", String(this.logarithmic));
    new ResizeObserver(() => this.fit()).observe(host);
  }

  toggle() {
    this.logarithmic = !this.logarithmic;
    store("localStorage", KEY, this.logarithmic ? "yes" : "no");
    setAttribute(this.button, "aria-pressed", String(this.logarithmic));
    this.rebuild();
  }

  /** Make the plot again, with the current colours and scale. */
  rebuild() {
    if (this.plot) this.plot.destroy();
    this.plot = null;
    if (!this.host.clientWidth || !this.model.hello) return;
    this.plot = new uPlot(this.options(), this.data(), this.host);
  }

  fit() {
    const size = { width: this.host.clientWidth, height: this.host.clientHeight };
    if (!size.width || !size.height) return;
    if (this.plot) this.plot.setSize(size);
    else this.rebuild();
  }

  update() {
    if (!this.host.clientWidth) return;
    if (!this.plot) this.rebuild();
    if (this.plot) this.plot.setData(this.data());
    const { error, known } = this.model.frame ?? {};
    const now = known ? `${format.length(known[0])} over ${known[3]}` : format.length(error);
    setHidden(byId("known-key"), !known);
    setAttribute(this.host, "aria-label", `Formation error over time; now ${now}`);
  }

  data() {
    const { error, known, origin, hello } = this.model;
    const floor = this.logarithmic ? LEAST : 0;
    const shown = ({ values }) => values.map((value) => (value === null ? null : Math.max(value, floor)));
    const times = error.times.map((time) => time - origin);
    return [times, shown(error), error.times.map(() => hello.settled), shown(known)];
  }

  options() {
    const unit = parseFloat(getComputedStyle(document.documentElement).fontSize) / 16;
    const font = `${Math.round(12 * unit)}px system-ui, sans-serif`;
    const line = { stroke: colour("grid"), width: 1 };
    const axis = { stroke: colour("muted"), font, grid: line, ticks: { show: false }, gap: 4 };
    const decades = { ...line, filter: (_, splits) => splits.map((split) => (isDecade(split) ? split : null)) };
    return {
      width: this.host.clientWidth,
      height: this.host.clientHeight,
      padding: [14 * unit, 18 * unit, 0, 0],
      legend: { show: false },
      cursor: { y: false, drag: { x: false, y: false }, points: { size: 7 } },
      scales: { x: { time: false }, y: this.logarithmic ? { distr: 3, range: logRange } : { range: linearRange } },
      axes: [
        { ...axis, size: 24 * unit, space: 70 * unit, incrs: SECONDS, values: (_, splits) => splits.map((split) => format.span(split)) },
        { ...axis, size: 56 * unit, values: (_, splits) => splits.map(tick), ...(this.logarithmic ? { grid: decades } : {}) },
      ],
      series: [
        {},
        { stroke: colour("accent"), width: 2, spanGaps: false, points: { show: false } },
        { stroke: colour("good"), width: 1.5, dash: [6, 4], points: { show: false } },
        { stroke: colour("warn"), width: 2, dash: [3, 3], spanGaps: false, points: { show: false } },
      ],
      hooks: { draw: [(plot) => this.mark(plot, unit)], setCursor: [(plot) => this.read(plot)] },
    };
  }

  /** Draw events as symbols on the upper border, with a line down. */
  mark(plot, unit) {
    const { ctx, bbox } = plot;
    const dots = devicePixelRatio || 1;
    ctx.save();
    ctx.font = `${11 * unit * dots}px system-ui, sans-serif`;
    ctx.textAlign = "center";
    ctx.textBaseline = "bottom";
    let last = -Infinity;
    for (const event of this.model.events) {
      const symbol = SYMBOLS[event.kind];
      const x = plot.valToPos(event.at - this.model.origin, "x", true);
      if (!symbol || !(x >= bbox.left && x <= bbox.left + bbox.width) || x < last + APART * unit * dots) continue;
      last = x;
      ctx.fillStyle = ctx.strokeStyle = colour(event.level >= 40 ? "bad" : event.level >= 30 ? "warn" : "muted");
      ctx.globalAlpha = 0.6;
      ctx.lineWidth = dots;
      ctx.setLineDash([2 * dots, 3 * dots]);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      ctx.globalAlpha = 1;
      ctx.fillText(symbol, x, bbox.top - dots);
    }
    ctx.restore();
  }

  /** Write the value under the cursor. */
  read(plot) {
    const { idx } = plot.cursor;
    const at = idx ?? -1;
    const value = plot.data[1][at] ?? plot.data[3][at] ?? null;
    const over = value !== null && (plot.data[1][at] ?? null) === null ? " over the known edges" : "";
    setText(byId("chart-reading"), value === null ? "" : `${format.length(value)}${over} at ${format.span(plot.data[0][at])}`);
  }
}

function tick(metres) {
  if (metres === null) return "";
  if (metres >= 1000) return `${+(metres / 1000).toFixed(1)} km`;
  return metres < 0.001 ? `${(1000 * metres).toFixed(1)} mm` : metres < 0.1 ? `${Math.round(1000 * metres)} mm` : `${+metres.toFixed(2)} m`;
}

function isDecade(value) {
  return Math.abs(Math.log10(value) - Math.round(Math.log10(value))) < 1e-6;
}

function logRange(_plot, low, high) {
  if (low === null) return [1e-3, 10];
  return [10 ** Math.floor(Math.log10(Math.max(low, LEAST))), 10 ** Math.ceil(Math.log10(Math.max(high, 2 * low, 1e-3)))];
}

function linearRange(_plot, _low, high) {
  return [0, high ? 1.08 * high : 1];
}
