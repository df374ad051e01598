/** The leader and its standbys: a chip for each, if there are standbys. */

import { byId, make, setAttribute, setHidden, setText } from "./dom.js";
import * as format from "./format.js";

const SYMBOLS = { leads: "★", standby: "◇", candidate: "◈", listening: "…", silent: "✕", unseen: "?" };
const TONES = { leads: "good", standby: "plain", silent: "bad" };
const WORDS = { silent: "lost" };

export class Candidates {
  constructor(model) {
    this.model = model;
    this.list = byId("candidates");
    this.chips = [];
  }

  greet() {
    const names = this.model.hello.candidates ?? [];
    setHidden(this.list, names.length === 0);
    this.chips = names.map((name) => make("li", { "data-candidate": name }));
    this.list.replaceChildren(...this.chips);
  }

  update() {
    const { frame, hello } = this.model;
    if (!frame?.c) return;
    hello.candidates.forEach((name, rank) => this.show(this.chips[rank], name, frame.c[rank], frame.since));
  }

  show(chip, name, [state, reason, age], since) {
    const word = WORDS[state] ?? state;
    setText(chip, `${SYMBOLS[state] ?? "!"} ${name} ${word}`);
    setAttribute(chip, "data-tone", TONES[state] ?? "warn");
    setAttribute(chip, "title", this.why(name, state, reason, age, since));
  }

  why(name, state, reason, age, since) {
    if (state === "leads") return `${name} leads since ${format.clock(since)}`;
    if (state === "silent") return `${name} has sent nothing for ${format.age(age)}: it cannot take over`;
    return `${name}: ${reason || state}`;
  }
}

/** The standby that leads, if the leader's own process does not. */
export function standIn(model, robot) {
  const leads = model.frame?.leads;
  return robot.leader && leads && leads !== robot.name ? leads : "";
}
