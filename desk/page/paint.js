// Drawing over the picture: dots, lengths, lines, lanes, vehicles, boxes.

import { toScreen } from "./stage.js";

/** @typedef {import("./types.js").Px} Px */
/** @typedef {import("./stage.js").Placed} Placed */
/** @typedef {CanvasRenderingContext2D} Context */

export const COLOURS = {
  length: "#ffd34d",
  line: "#59b7ff",
  rectangle: "#c792ff",
  vehicle: "#4cd07d",
  ignored: "#9aa9b6",
  bad: "#ff6b5e",
  accent: "#35c2ad",
};
/** Lanes by their number. */
const LANES = ["#35c2ad", "#59b7ff", "#c792ff", "#ffb454", "#7bd88f", "#ff8fb1", "#9fb6ff", "#e6d36a"];
/** @param {number} number */
export const laneColour = (number) => LANES[(number + LANES.length - 1) % LANES.length];

/** Limits of the stated error and their colours: good, fair, poor, refused. @type {[number, string][]} */
export const ERRORS = [[0.03, "#4cd07d"], [0.07, "#d9d94f"], [0.15, "#ff9f45"], [Infinity, "#ff5548"]];
/** @param {number} rel */
export const errorColour = (rel) => (ERRORS.find(([limit]) => rel <= limit) ?? ERRORS[3])[1];

/** @param {Context} c @param {Placed} placed @param {Px[]} points @param {boolean} [closed] */
export function path(c, placed, points, closed = false) {
  c.beginPath();
  points.forEach((p, k) => {
    const [x, y] = toScreen(placed, p);
    if (k === 0) c.moveTo(x, y);
    else c.lineTo(x, y);
  });
  if (closed) c.closePath();
}

/**
 * A line with a dark rim, to be seen on any ground.
 * @param {Context} c @param {Placed} placed @param {Px[]} points @param {string} colour
 * @param {{width?: number, closed?: boolean, dash?: number[]}} [how]
 */
export function stroke(c, placed, points, colour, { width = 2, closed = false, dash = [] } = {}) {
  path(c, placed, points, closed);
  c.setLineDash([]);
  c.lineJoin = "round";
  c.strokeStyle = "#000000a0";
  c.lineWidth = width + 2;
  c.stroke();
  c.setLineDash(dash);
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.stroke();
  c.setLineDash([]);
}

/** @param {Context} c @param {Placed} placed @param {Px} p @param {string} colour @param {boolean} [chosen] */
export function knob(c, placed, p, colour, chosen = false) {
  const [x, y] = toScreen(placed, p);
  c.beginPath();
  c.arc(x, y, chosen ? 5.5 : 4, 0, 2 * Math.PI);
  c.fillStyle = chosen ? "#fff" : colour;
  c.fill();
  c.lineWidth = 1.5;
  c.strokeStyle = "#000000c0";
  c.stroke();
  c.beginPath();
  c.arc(x, y, 1, 0, 2 * Math.PI);
  c.fillStyle = "#000";
  c.fill();
}

/** @param {Context} c @param {Placed} placed @param {Px} p @param {string} text @param {string} colour @param {number} [dy] */
export function label(c, placed, p, text, colour, dy = 0) {
  const [x, y] = toScreen(placed, p);
  c.font = "600 12px system-ui, sans-serif";
  const width = c.measureText(text).width + 10;
  c.fillStyle = "#0c1116d8";
  c.beginPath();
  c.roundRect(x - width / 2, y - 9 + dy, width, 18, 5);
  c.fill();
  c.fillStyle = colour;
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillText(text, x, y + dy);
}

/** @param {Context} c @param {Placed} placed @param {[number, number, number][]} dots */
export function dots(c, placed, dots) {
  const radius = Math.min(3.2, Math.max(1.3, 0.55 * placed.scale));
  for (const [u, v, error] of dots) {
    const [x, y] = toScreen(placed, [u, v]);
    c.beginPath();
    c.arc(x, y, radius, 0, 2 * Math.PI);
    c.fillStyle = errorColour(error);
    c.fill();
  }
}

/** @param {Px[]} points @returns {Px} */
export const middle = (points) => {
  const n = points.length || 1;
  return [points.reduce((s, p) => s + p[0], 0) / n, points.reduce((s, p) => s + p[1], 0) / n];
};

/**
 * An arrow along the last part of a lane's middle.
 * @param {Context} c @param {Placed} placed @param {Px[]} line @param {string} colour
 */
export function arrow(c, placed, line, colour) {
  if (line.length < 2) return;
  const screen = line.map((p) => toScreen(placed, p));
  stroke(c, placed, line, colour, { width: 1.5, dash: [7, 6] });
  // In the middle of the visible length: perspective crowds the far half.
  const total = screen.slice(1).reduce((s, p, k) => s + Math.hypot(p[0] - screen[k][0], p[1] - screen[k][1]), 0);
  let rest = total / 2;
  for (let k = 1; k < screen.length; k++) {
    const [a, b] = [screen[k - 1], screen[k]];
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (rest <= length && length > 0) {
      const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
      const t = rest / length;
      c.save();
      c.translate(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]));
      c.rotate(angle);
      c.beginPath();
      c.moveTo(13, 0);
      c.lineTo(-7, 9);
      c.lineTo(-3, 0);
      c.lineTo(-7, -9);
      c.closePath();
      c.fillStyle = colour;
      c.strokeStyle = "#000000c0";
      c.lineWidth = 1.5;
      c.fill();
      c.stroke();
      c.restore();
      return;
    }
    rest -= length;
  }
}

/**
 * @param {Context} c @param {Placed} placed @param {Px[]} polygon @param {string} colour
 * @param {string} ground
 */
export function area(c, placed, polygon, colour, ground) {
  path(c, placed, polygon, true);
  c.fillStyle = ground;
  c.fill();
  stroke(c, placed, polygon, colour, { closed: true });
}

/**
 * A detector's box with the point that stands for its vehicle.
 * @param {Context} c @param {Placed} placed @param {import("./types.js").Counted} box @param {Px} shift
 */
export function vehicleBox(c, placed, box, shift) {
  const [x0, y0, x1, y1] = box.corners;
  const at = (/** @type {number} */ u, /** @type {number} */ v) => /** @type {Px} */ ([u - shift[0], v - shift[1]]);
  const colour = box.lane ? laneColour(box.lane) : "#c9d2da";
  const corners = [at(x0, y0), at(x1, y0), at(x1, y1), at(x0, y1)];
  stroke(c, placed, corners, colour, { closed: true, width: box.lane ? 2 : 1, dash: box.lane ? [] : [4, 4] });
  const foot = at((x0 + x1) / 2, y1);
  if (box.lane === null) return;
  knob(c, placed, foot, colour, true);
  label(c, placed, at((x0 + x1) / 2, y0), String(box.lane), colour, -11);
}
