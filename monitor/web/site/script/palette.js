/** The style sheet's colours, for canvases. */

const NAMES = [
  "canvas", "ink", "muted", "grid", "axis", "accent", "robot", "bad", "warn", "good",
  "edge-1", "edge-2", "edge-3", "edge-4",
  "robot-1", "robot-2", "robot-3", "robot-4", "robot-5", "robot-6", "robot-7", "robot-8",
];
const OWN_COLOURS = 8; // largest number of robots with a colour each

let colours = {};

export function readPalette() {
  const probe = document.createElement("span");
  probe.hidden = true;
  document.body.append(probe);
  colours = {};
  for (const name of NAMES) {
    probe.style.color = `var(--${name})`;
    colours[name] = getComputedStyle(probe).color;
  }
  probe.remove();
}

export function colour(name) {
  return colours[name];
}

/** A robot's own colour, or the common one if there are too many. */
export function robotColour(robot, count) {
  if (robot.leader) return colours.ink;
  return count <= OWN_COLOURS ? colours[`robot-${robot.index}`] ?? colours.robot : colours.robot;
}

/** Colour and width of edges by their error [m]; the width shows it without colour. */
const EDGE_STEPS = [
  { under: 0.01, colour: "edge-1", width: 1.25 },
  { under: 0.05, colour: "edge-2", width: 2 },
  { under: 0.2, colour: "edge-3", width: 3 },
  { under: Infinity, colour: "edge-4", width: 4.25 },
];

export function edgeStep(error) {
  return EDGE_STEPS.find((step) => error < step.under);
}
