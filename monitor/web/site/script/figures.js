/** One robot in the top view: a triangle along its heading; form and colour show its state. */

import { colour, robotColour } from "./palette.js";
import { circle, disc, line } from "./pen.js";

const VISIBLE_ANGLE = 0.09; // [rad]
const VISIBLE = 4; // [px]

/** Draw the true pose, if it differs visibly from the robot's own. */
export function drawGhost(pen, camera, robot, size, unit) {
  const { place, truth } = robot;
  if (!truth || robot.lost) return;
  const off = camera.scale * Math.hypot(truth.x - place.x, truth.y - place.y);
  if (off < VISIBLE * unit && Math.abs(truth.heading - place.heading) < VISIBLE_ANGLE) return;
  pen.save();
  pen.strokeStyle = colour("muted");
  pen.lineWidth = 1.25 * unit;
  pen.setLineDash([2 * unit, 2 * unit]);
  triangle(pen, camera, truth, size);
  pen.stroke();
  pen.restore();
}

export function drawRobot(pen, camera, robot, model, size, unit) {
  const { place } = robot;
  if (!place) return;
  const own = robotColour(robot, model.robots.length);
  const [x, y] = [camera.sx(place.x), camera.sy(place.y)];
  pen.save();
  pen.lineJoin = "round";
  if (robot.name === model.chosen || robot.leader) ring(pen, x, y, size, robot, model, unit);
  if (!robot.lost) controlPoint(pen, camera, robot, own, x, y, unit);
  triangle(pen, camera, place, size);
  if (robot.lost) lost(pen, x, y, size, unit);
  else if (robot.state === "run") solid(pen, own, unit);
  else hollow(pen, robot, own, x, y, size, unit);
  pen.restore();
}

function triangle(pen, camera, { x, y, heading }, size) {
  const at = (angle, far) => [
    camera.sx(x) + far * Math.cos(heading + angle),
    camera.sy(y) - far * Math.sin(heading + angle),
  ];
  pen.beginPath();
  pen.moveTo(...at(0, 1.15 * size));
  pen.lineTo(...at(2.5, 0.95 * size));
  pen.lineTo(...at(Math.PI, 0.45 * size));
  pen.lineTo(...at(-2.5, 0.95 * size));
  pen.closePath();
}

function solid(pen, own, unit) {
  pen.fillStyle = own;
  pen.fill();
  pen.strokeStyle = colour("canvas");
  pen.lineWidth = 1 * unit;
  pen.stroke();
}

/** A robot that stands: an outline with a square (stop), two bars (hold) or nothing (other states). */
function hollow(pen, robot, own, x, y, size, unit) {
  const stopped = robot.state === "stop";
  pen.fillStyle = colour("canvas");
  pen.fill();
  pen.strokeStyle = stopped ? colour("bad") : own;
  pen.lineWidth = 2 * unit;
  pen.stroke();
  pen.fillStyle = pen.strokeStyle;
  const half = 0.26 * size;
  if (stopped) pen.fillRect(x - half, y - half, 2 * half, 2 * half);
  if (robot.state === "hold") {
    pen.fillRect(x - half, y - half, 0.7 * half, 2 * half);
    pen.fillRect(x + 0.3 * half, y - half, 0.7 * half, 2 * half);
  }
}

function lost(pen, x, y, size, unit) {
  pen.strokeStyle = colour("bad");
  pen.lineWidth = 1.5 * unit;
  pen.setLineDash([3 * unit, 2 * unit]);
  pen.stroke();
  pen.setLineDash([]);
  pen.lineWidth = 2.25 * unit;
  line(pen, [x - size, y - size], [x + size, y + size]);
  line(pen, [x + size, y - size], [x - size, y + size]);
}

function ring(pen, x, y, size, robot, model, unit) {
  const chosen = robot.name === model.chosen;
  pen.strokeStyle = colour(chosen ? "accent" : "ink");
  pen.lineWidth = (chosen ? 3 : 1.25) * unit;
  circle(pen, x, y, 1.55 * size);
}

function controlPoint(pen, camera, robot, own, x, y, unit) {
  const [px, py] = [camera.sx(robot.place.px), camera.sy(robot.place.py)];
  if (Math.hypot(px - x, py - y) < VISIBLE) return;
  pen.strokeStyle = pen.fillStyle = own;
  pen.lineWidth = 1.25 * unit;
  line(pen, [x, y], [px, py]);
  disc(pen, px, py, 2.25 * unit);
}
