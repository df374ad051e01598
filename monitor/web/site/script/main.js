/** The page: the stream updates the model, and the parts show it. */

import { Candidates } from "./candidates.js";
import { ErrorChart } from "./chart.js";
import { DrivePad } from "./drive.js";
import { byId, setAttribute, setText } from "./dom.js";
import { EventList } from "./events.js";
import { Header } from "./header.js";
import { Model } from "./model.js";
import { Orders } from "./orders.js";
import { readPalette } from "./palette.js";
import { ReplayBar } from "./replay.js";
import { RouteOrder } from "./route.js";
import { store } from "./store.js";
import { Stream } from "./stream.js";
import { RobotTable } from "./table.js";
import { takeFromAddress } from "./token.js";
import { TopView } from "./top_view.js";

const TABLE_EVERY = 200; // [ms]; numbers that change more often cannot be read
const CHART_EVERY = 500; // [ms]
const WATCH_EVERY = 100; // [ms]
const THEMES = ["auto", "light", "dark"];

takeFromAddress();
readPalette();
const model = new Model();
const choose = (name) => {
  model.choose(name);
  table.reveal();
  view.draw();
};
const view = new TopView(
  model,
  { canvas: byId("map"), follow: byId("follow"), nearer: byId("nearer"), farther: byId("farther") },
  choose,
);
const table = new RobotTable(model, choose);
const candidates = new Candidates(model);
const chart = new ErrorChart(model, byId("chart"));
const events = new EventList(model);
const orders = new Orders(model);
new DrivePad();
const route = new RouteOrder(model, view, orders);
const replay = new ReplayBar(model);
const stream = new Stream("stream", {
  hello: (hello) => {
    model.greet(hello);
    for (const part of [header, orders, route, replay, candidates]) part.greet();
    table.build();
    events.rebuild();
    chart.rebuild();
  },
  frame: (frame) => {
    model.take(frame);
    requestFrame();
  },
  event: (event) => {
    model.note(event);
    events.add();
  },
}, () => replay.begin());
const header = new Header(model, stream);

let requested = false;
const done = { table: { at: 0, frames: 0 }, chart: { at: 0, frames: 0 } };

/** Show the newest frame with the browser's next picture; frames between are not painted. */
function requestFrame() {
  if (requested) return;
  requested = true;
  requestAnimationFrame(() => {
    requested = false;
    show(performance.now());
  });
}

/** Show the newest frame; `catchUp` updates numbers at a rate that can be read. */
function show(now) {
  view.paint();
  header.update();
  replay.update();
  catchUp(now);
}

function catchUp(now) {
  events.update();
  if (due("table", now, TABLE_EVERY)) {
    table.update();
    candidates.update();
  }
  if (due("chart", now, CHART_EVERY)) {
    chart.update();
    describe();
  }
}

function due(part, now, every) {
  if (done[part].frames === model.frames || now - done[part].at < every) return false;
  done[part] = { at: now, frames: model.frames };
  return true;
}

/** The top view in a sentence, for screen readers. */
function describe() {
  const lost = model.robots.filter((robot) => robot.lost).map((robot) => robot.name);
  const leads = model.frame?.leads ? `; ${model.frame.leads} leads` : "";
  const text = `Top view of ${model.robots.length} robots${leads}` + (lost.length ? `; lost: ${lost.join(", ")}` : "");
  setAttribute(byId("map"), "aria-label", text);
}

function setTheme(theme) {
  if (theme === "auto") {
    delete document.documentElement.dataset.theme;
  } else {
    document.documentElement.dataset.theme = theme;
  }
  store("localStorage", "formation-theme", theme);
  setText(byId("theme"), `${{ auto: "◐", light: "☀", dark: "☾" }[theme]} ${theme}`);
  repaint();
}

function repaint() {
  readPalette();
  chart.rebuild();
  view.draw();
}

function nextTheme() {
  const now = document.documentElement.dataset.theme ?? "auto";
  setTheme(THEMES[(THEMES.indexOf(now) + 1) % THEMES.length]);
}

/** Show one part of the page; used on narrow screens. */
function showTab(name) {
  document.body.dataset.tab = name;
  for (const button of document.querySelectorAll("[data-shows]")) {
    setAttribute(button, "aria-pressed", String(button.dataset.shows === name));
  }
  if (model.frame) show(performance.now());
  chart.fit();
}

setTheme(document.documentElement.dataset.theme ?? "auto");
byId("theme").addEventListener("click", nextTheme);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
for (const button of document.querySelectorAll("[data-shows]")) {
  button.addEventListener("click", () => showTab(button.dataset.shows));
}
setInterval(() => {
  header.watch();
  catchUp(performance.now());
}, WATCH_EVERY);
window.formation = { model, stream, view }; // for tests and the browser's console
