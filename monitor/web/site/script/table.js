/** The robots, a row each. Rows remain the same elements; their text and order change. */

import { byId, setAttribute, setHidden, setText } from "./dom.js";
import { Row } from "./row.js";

const MANY = 12; // number of robots above which those in trouble come first
const SORT_EVERY = 2000; // time between two sorts [ms]
const SORT_NEWS = 500; // the same after a change of a state [ms]
const ORDERS = {
  name: (robot) => robot.index,
  state: (robot) => robot.word,
  error: (robot) => robot.get("error") ?? -1,
  speed: (robot) => robot.get("speed_share") ?? -1,
  turn_rate: (robot) => robot.get("turn_rate_share") ?? -1,
  age: (robot) => robot.get("age") ?? Infinity,
  rate: (robot) => robot.get("rate") ?? -1,
  loss: (robot) => robot.get("loss") ?? -1,
  health: (robot) => robot.trouble,
};
const WORST_FIRST = new Set(["health", "error", "age", "loss", "speed", "turn_rate"]);

export class RobotTable {
  constructor(model, choose) {
    this.model = model;
    this.choose = choose;
    this.body = byId("robot-rows");
    this.headers = [...document.querySelectorAll("#robot-table th[data-sort]")];
    this.filter = byId("robot-filter");
    this.rows = [];
    this.sorted = -Infinity;
    for (const header of this.headers) {
      header.querySelector("button").addEventListener("click", () => this.sortBy(header.dataset.sort));
    }
    this.filter.addEventListener("input", () => this.update({ sort: true }));
  }

  /** Make the rows of a connection's robots. */
  build() {
    const { robots } = this.model;
    if (this.rows.length === robots.length && this.rows.every((row, n) => row.robot === robots[n])) return;
    this.rows = robots.map((robot) => new Row(robot, robots.length, this.choose));
    this.body.replaceChildren(...this.rows.map((row) => row.element));
    setHidden(this.filter.parentElement, robots.length <= MANY);
    this.order = robots.length > MANY ? { by: "health", down: true } : { by: "name", down: false };
    this.showOrder();
  }

  sortBy(by) {
    const down = this.order.by === by ? !this.order.down : WORST_FIRST.has(by);
    this.order = { by, down };
    this.showOrder();
    this.update({ sort: true });
  }

  showOrder() {
    for (const header of this.headers) {
      const own = header.dataset.sort === this.order.by;
      setAttribute(header, "aria-sort", own ? (this.order.down ? "descending" : "ascending") : "none");
    }
  }

  update({ sort = false } = {}) {
    for (const row of this.rows) row.update(this.model.chosen);
    const states = this.tell();
    const since = performance.now() - this.sorted;
    const news = states !== this.states && since > SORT_NEWS;
    if (sort || news || since > SORT_EVERY) {
      this.states = states;
      this.arrange();
    }
  }

  arrange() {
    this.sorted = performance.now();
    const key = ORDERS[this.order.by];
    const sign = this.order.down ? -1 : 1;
    const keyed = this.rows.map((row) => [key(row.robot), row]);
    keyed.sort(([a, one], [b, other]) =>
      a === b ? one.robot.index - other.robot.index : sign * (a < b ? -1 : 1));
    keyed.forEach(([, row], place) => {
      if (this.body.children[place] !== row.element) this.body.insertBefore(row.element, this.body.children[place]);
    });
    const wanted = this.filter.value.trim().toLowerCase();
    for (const row of this.rows) setHidden(row.element, !row.matches(wanted));
  }

  /** Write the number of robots in each state above the table, and return the text. */
  tell() {
    const counts = new Map();
    for (const { robot } of this.rows) counts.set(robot.word, (counts.get(robot.word) ?? 0) + 1);
    const words = [...counts].map(([word, count]) => `${count} ${word}`).join(" · ");
    setText(byId("robot-count"), words);
    const shown = this.rows.filter((row) => !row.element.hidden).length;
    setHidden(byId("robot-none"), shown > 0 || !this.rows.length);
    return words;
  }

  /** Bring the chosen robot's row into sight. */
  reveal() {
    const row = this.rows.find(({ robot }) => robot.name === this.model.chosen);
    this.update();
    if (row) row.element.scrollIntoView({ block: "nearest" });
  }
}

