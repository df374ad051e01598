/** The top view in layers: grid, posts and walls, trails, edges, slots, true poses, robots, names, scale bar. */

import { standIn } from "./candidates.js";
import { colour, edgeStep, robotColour } from "./palette.js";
import { drawGhost, drawRobot } from "./figures.js";
import { length } from "./format.js";
import { circle, disc, line } from "./pen.js";

const ARROWS = 14; // largest number of robots with which edges have arrows
const VISIBLE = 4; // smallest offset that is drawn [px]
const NAMES = 24; // largest number of robots that are all named

export function draw(pen, camera, model, unit) {
  pen.clearRect(0, 0, camera.width, camera.height);
  drawGrid(pen, camera);
  const size = sizeOf(model, camera, unit);
  drawThings(pen, camera, model, unit);
  for (const robot of model.robots) drawTrail(pen, camera, robot, model, unit);
  drawEdges(pen, camera, model, unit);
  for (const robot of model.robots) drawSlot(pen, camera, robot, size, unit);
  for (const robot of model.robots) drawGhost(pen, camera, robot, size, unit);
  for (const robot of model.robots) drawRobot(pen, camera, robot, model, size, unit);
  drawNames(pen, camera, model, size, unit);
  drawPlanned(pen, camera, model, unit);
  drawScale(pen, camera, unit);
}

/** Half the length of a robot's triangle [px]: it grows with the scale, within limits. */
function sizeOf(model, camera, unit) {
  const few = model.robots.length <= NAMES;
  return Math.min(Math.max(0.16 * camera.scale, (few ? 9 : 7) * unit), (few ? 20 : 12) * unit);
}

/** Distance between two lines of the grid [m]: 1, 2 or 5 times a power of ten, at least `least` pixels. */
function gridStep(scale, least) {
  const power = 10 ** Math.floor(Math.log10(least / scale));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step * scale >= least);
}

function drawGrid(pen, camera) {
  const step = gridStep(camera.scale, 56);
  const [halfWide, halfHigh] = [camera.width / 2 / camera.scale, camera.height / 2 / camera.scale];
  pen.lineWidth = 1;
  const rule = (n, ...ends) => {
    pen.strokeStyle = colour(n % 5 === 0 ? "axis" : "grid");
    line(pen, ...ends);
  };
  for (let n = Math.ceil((camera.x - halfWide) / step); n * step <= camera.x + halfWide; n += 1) {
    const sx = Math.round(camera.sx(n * step)) + 0.5;
    rule(n, [sx, 0], [sx, camera.height]);
  }
  for (let n = Math.ceil((camera.y - halfHigh) / step); n * step <= camera.y + halfHigh; n += 1) {
    const sy = Math.round(camera.sy(n * step)) + 0.5;
    rule(n, [0, sy], [camera.width, sy]);
  }
}

/** Draw the planned route: from the leader through each point. */
function drawPlanned(pen, camera, { planned, robots }, unit) {
  if (!planned.length) return;
  const leader = robots.find((robot) => robot.leader)?.place;
  const path = [...(leader ? [[leader.x, leader.y]] : []), ...planned].map(([x, y]) => [camera.sx(x), camera.sy(y)]);
  pen.strokeStyle = pen.fillStyle = colour("accent");
  pen.lineWidth = 2 * unit;
  pen.setLineDash([6 * unit, 4 * unit]);
  line(pen, ...path);
  pen.setLineDash([]);
  for (const [x, y] of path.slice(leader ? 1 : 0)) disc(pen, x, y, 5 * unit);
}

/** Draw posts and walls of a simulated world, if there is ground truth. */
function drawThings(pen, camera, { hello, robots }, unit) {
  if (!robots.some((robot) => robot.truth)) return;
  pen.fillStyle = pen.strokeStyle = colour("muted");
  for (const [x, y, radius] of hello.posts) {
    disc(pen, camera.sx(x), camera.sy(y), Math.max(radius * camera.scale, unit));
  }
  pen.lineWidth = 3 * unit;
  pen.lineCap = "round";
  for (const [fromX, fromY, toX, toY] of hello.walls) {
    line(pen, [camera.sx(fromX), camera.sy(fromY)], [camera.sx(toX), camera.sy(toY)]);
  }
  pen.lineCap = "butt";
}

function drawTrail(pen, camera, robot, model, unit) {
  if (robot.trail.length < 2) return;
  pen.beginPath();
  robot.trail.each((x, y) => pen.lineTo(camera.sx(x), camera.sy(y)));
  if (robot.place) pen.lineTo(camera.sx(robot.place.x), camera.sy(robot.place.y));
  pen.strokeStyle = robotColour(robot, model.robots.length);
  pen.lineWidth = 1.5 * unit;
  pen.globalAlpha = robot.name === model.chosen ? 1 : model.robots.length > NAMES ? 0.25 : 0.45;
  if (robot.leader) pen.setLineDash([2 * unit, 4 * unit]);
  pen.stroke();
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

function drawEdges(pen, camera, model, unit) {
  const many = model.robots.length > NAMES;
  model.edges.forEach(([from, to], index) => {
    const [here, there] = [model.robots[from].place, model.robots[to].place];
    if (!here || !there) return;
    const error = model.frame.e[index] ?? null;
    const step = error === null ? null : edgeStep(error);
    const ends = [here, there].map(({ px, py }) => [camera.sx(px), camera.sy(py)]);
    pen.strokeStyle = pen.fillStyle = colour(step ? step.colour : "muted");
    pen.lineWidth = (step ? step.width * (many ? 0.55 : 1) : 1) * unit;
    pen.globalAlpha = many ? 0.6 : 1;
    if (!step) pen.setLineDash([3 * unit, 5 * unit]);
    line(pen, ...ends);
    pen.setLineDash([]);
    pen.globalAlpha = 1;
    if (model.robots.length <= ARROWS) drawArrow(pen, ends, (5 + pen.lineWidth) * unit);
  });
}

/** An arrow head a little past the middle, towards the measured robot. */
function drawArrow(pen, [[fx, fy], [tx, ty]], size) {
  const long = Math.hypot(tx - fx, ty - fy);
  if (long < 6 * size) return;
  const [ux, uy] = [(tx - fx) / long, (ty - fy) / long];
  const [x, y] = [fx + 0.58 * (tx - fx), fy + 0.58 * (ty - fy)];
  pen.beginPath();
  pen.moveTo(x + ux * size, y + uy * size);
  pen.lineTo(x - (ux - 0.6 * uy) * size * 0.5, y - (uy + 0.6 * ux) * size * 0.5);
  pen.lineTo(x - (ux + 0.6 * uy) * size * 0.5, y - (uy - 0.6 * ux) * size * 0.5);
  pen.fill();
}

/** Draw a slot: a ring, with a line to the control point. */
function drawSlot(pen, camera, robot, size, unit) {
  const { slot, place } = robot;
  if (!slot || robot.leader) return;
  const [sx, sy] = [camera.sx(slot.x), camera.sy(slot.y)];
  pen.strokeStyle = colour("muted");
  pen.lineWidth = 1.25 * unit;
  circle(pen, sx, sy, Math.max(0.32 * size, 3 * unit));
  if (!place) return;
  const [px, py] = [camera.sx(place.px), camera.sy(place.py)];
  if (Math.hypot(px - sx, py - sy) < VISIBLE * unit) return;
  pen.setLineDash([1 * unit, 3 * unit]);
  line(pen, [px, py], [sx, sy]);
  pen.setLineDash([]);
}

function drawNames(pen, camera, model, size, unit) {
  const many = model.robots.length > NAMES;
  const prefix = many ? commonPrefix(model.robots.map((robot) => robot.name)) : 0;
  const room = spacing(model, camera) > 30 * unit;
  pen.textAlign = "center";
  pen.textBaseline = "top";
  pen.lineJoin = "round";
  for (const robot of model.robots) {
    const chosen = robot.name === model.chosen;
    const seen = robot.place && camera.sees(robot.place);
    if (!seen || (many && !room && !chosen && !robot.lost && !robot.leader)) continue;
    const name = many && !chosen && !robot.leader ? robot.name.slice(prefix) : robot.name;
    const other = standIn(model, robot);
    const text = robot.lost ? `${name} lost ${robot.get("age").toFixed(1)} s` : other ? `${name}: ${other} leads` : name;
    pen.font = `${chosen || robot.lost ? 700 : 500} ${(many ? 10.5 : 12) * unit}px system-ui, sans-serif`;
    const half = pen.measureText(text).width / 2 + 4 * unit;
    const x = Math.min(Math.max(camera.sx(robot.place.x), half), camera.width - half);
    const y = camera.sy(robot.place.y) + (robot.leader ? 1.6 : 1) * size + 3 * unit;
    pen.strokeStyle = colour("canvas");
    pen.lineWidth = 4 * unit;
    pen.strokeText(text, x, y);
    pen.fillStyle = colour(robot.lost ? "bad" : "ink");
    pen.fillText(text, x, y);
  }
}

/** Approximate distance between robots if they were spread evenly [px]. */
function spacing(model, camera) {
  const xs = model.robots.filter((robot) => robot.place).map((robot) => robot.place);
  if (xs.length < 2) return Infinity;
  const span = (values) => Math.max(...values) - Math.min(...values);
  const area = Math.max(span(xs.map((p) => p.x)), 1) * Math.max(span(xs.map((p) => p.y)), 1);
  return camera.scale * Math.sqrt(area / xs.length);
}

function commonPrefix(names) {
  let end = 0;
  while (names.every((name) => name.length > end + 1 && name[end] === names[0][end])) end += 1;
  return end;
}

function drawScale(pen, camera, unit) {
  const step = gridStep(camera.scale, 70 * unit);
  const [right, y] = [camera.width - 14 * unit, camera.height - 14 * unit];
  const left = right - step * camera.scale;
  pen.strokeStyle = pen.fillStyle = colour("ink");
  pen.lineWidth = 1.5 * unit;
  line(pen, [left, y - 4 * unit], [left, y], [right, y], [right, y - 4 * unit]);
  pen.font = `${12 * unit}px system-ui, sans-serif`;
  pen.textAlign = "center";
  pen.textBaseline = "bottom";
  pen.fillText(step >= 1 ? `${step} m` : step >= 0.01 ? `${Math.round(100 * step)} cm` : length(step), (left + right) / 2, y - 4 * unit);
}
