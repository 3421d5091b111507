// The tools of a hand: what a click in the picture does.

import { knob, stroke, COLOURS } from "./paint.js";
import { toScreen } from "./stage.js";

/** @typedef {import("./types.js").Px} Px */
/** @typedef {import("./types.js").Handle} Handle */
/** @typedef {import("./types.js").Drawing} Drawing */
/** @typedef {import("./main.js").Desk} Desk */

/** How near the mouse takes a point, screen px. */
const REACH = 9;

/** @param {Px} a @param {Px} b */
export const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

/**
 * The nearest place on a polyline.
 * @param {Px} p @param {Px[]} line
 * @returns {Px | null}
 */
export function nearestOn(p, line) {
  /** @type {{at: Px, away: number} | null} */
  let best = null;
  for (let k = 1; k < line.length; k++) {
    const [a, b] = [line[k - 1], line[k]];
    const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
    const t = Math.max(0, Math.min(1, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy || 1)));
    /** @type {Px} */
    const at = [a[0] + t * dx, a[1] + t * dy];
    const away = distance(p, at);
    if (!best || away < best.away) best = { at, away };
  }
  return best && best.at;
}

/** @param {Px} p @param {Px[]} polygon */
export function isInside(p, polygon) {
  let inside = false;
  for (let k = 0, j = polygon.length - 1; k < polygon.length; j = k++) {
    const [a, b] = [polygon[k], polygon[j]];
    if (a[1] > p[1] !== b[1] > p[1] && p[0] < a[0] + ((p[1] - a[1]) / (b[1] - a[1])) * (b[0] - a[0])) inside = !inside;
  }
  return inside;
}

/**
 * Every point that a step lets be moved.
 * @param {Drawing} d @param {Set<string>} kinds
 * @returns {Handle[]}
 */
export function handles(d, kinds) {
  /** @type {Handle[]} */
  const all = [];
  /** @type {(kind: Handle["kind"], index: number, points: Px[]) => void} */
  const add = (kind, index, points) => {
    if (kinds.has(kind)) points.forEach((at, k) => all.push({ kind, index, point: String(k), at }));
  };
  d.lengths.forEach((s, k) => add("length", k, s.points));
  d.lines.forEach((s, k) => add("line", k, s.points));
  d.rectangles.forEach((s, k) => add("rectangle", k, s));
  d.lanes.forEach((s, k) => add("lane", k, s.polygon));
  d.ignored.forEach((s, k) => add("ignored", k, s));
  if (kinds.has("vehicle"))
    d.vehicles.forEach((v, index) =>
      Object.entries(v.points).forEach(([point, at]) => all.push({ kind: "vehicle", index, point, at })),
    );
  return all;
}

/** @param {Drawing} d @param {Handle} h @param {Px} to */
export function moveHandle(d, h, to) {
  if (h.kind === "vehicle") d.vehicles[h.index].points[h.point] = to;
  else pointsOf(d, h)[Number(h.point)] = to;
}

/** @param {Drawing} d @param {{kind: Handle["kind"], index: number}} h @returns {Px[]} */
function pointsOf(d, h) {
  switch (h.kind) {
    case "length": return d.lengths[h.index].points;
    case "line": return d.lines[h.index].points;
    case "rectangle": return d.rectangles[h.index];
    case "lane": return d.lanes[h.index].polygon;
    default: return d.ignored[h.index];
  }
}

/** What is drawn, by kind. @param {Drawing} d */
export const lists = (d) => ({
  length: d.lengths, line: d.lines, rectangle: d.rectangles, vehicle: d.vehicles, lane: d.lanes, ignored: d.ignored,
});

/** @param {Drawing} d @param {{kind: Handle["kind"], index: number}} what */
export function remove(d, what) {
  const [gone] = lists(d)[what.kind].splice(what.index, 1);
  if (what.kind === "line" && gone && "id" in gone) {
    const { id } = gone;
    d.apart = d.apart.filter((pair) => !pair.includes(id));
  }
}

/** The mouse in the picture: takes points that are there, else gives clicks to the tool. */
export class Hand {
  /** @param {Desk} desk */
  constructor(desk) {
    this.desk = desk;
    /** @type {Handle | null} */
    this.held = null;
    /** The points of what is being drawn. @type {Px[]} */
    this.pending = [];
    this.isDragging = false;
    /** Whether what is pending is one point that was there and was clicked: it may just be selected. */
    this.isOffered = false;
  }

  /** @param {Px} at @returns {Handle | null} */
  near(at) {
    const { desk } = this;
    const scale = desk.stage.placed.scale;
    let best = null;
    let least = REACH / scale;
    for (const handle of handles(desk.store.drawing, desk.movable())) {
      const away = distance(at, handle.at);
      if (away <= least) [best, least] = [handle, away];
    }
    return best;
  }

  /** @param {Px} at @param {PointerEvent} event */
  down(at, event) {
    const { desk } = this;
    const { tool } = desk;
    const isFree = this.pending.length === 0 || this.isOffered;
    const held = isFree && !event.altKey ? this.near(at) : null;
    // A tool of its own kind, or none, takes what is there; others may begin at the same place.
    if (held && (!tool || tool.takes === held.kind || tool.takes === "")) {
      this.held = held;
      this.isDragging = false;
      desk.select({ kind: held.kind, index: held.index });
      return;
    }
    if (!tool) {
      desk.select(desk.under(at));
      return;
    }
    const inside = at.every((x, k) => x >= -2 && x <= desk.site.image_size[k] + 2);
    if (!inside) return;
    this.isOffered = false;
    tool.click(this.desk.snapped(at, event), this, event);
    desk.stage.paint();
  }

  /** @param {Px} at @param {PointerEvent} event */
  move(at, event) {
    const { desk, held } = this;
    if (!held) {
      desk.hover(at);
      return;
    }
    const first = !this.isDragging;
    if (first && distance(at, held.at) * desk.stage.placed.scale < 2) return;
    this.isDragging = true;
    const to = desk.snapped(at, event, held);
    desk.store.edit((d) => moveHandle(d, held, to), `move ${held.kind} ${held.index} ${held.point}`);
  }

  up() {
    const { desk, held } = this;
    this.held = null;
    if (this.isDragging) desk.store.last = { key: "", at: 0 };
    else if (held && desk.tool?.begins && desk.tool.takes === held.kind) {
      this.pending = [[held.at[0], held.at[1]]];
      this.isOffered = true;
    }
    this.isDragging = false;
  }

  /** Takes back a beginning that was only offered. */
  withdraw() {
    if (this.isOffered) this.cancel();
  }

  finish() {
    this.desk.tool?.finish?.(this);
    this.desk.stage.paint();
  }

  cancel() {
    this.pending = [];
    this.isOffered = false;
    this.desk.stage.paint();
  }

  /** @param {CanvasRenderingContext2D} c @param {import("./stage.js").Placed} placed */
  paint(c, placed) {
    const { desk } = this;
    if (!this.pending.length || !desk.tool) return;
    const mouse = desk.stage.mouse;
    const line = mouse ? [...this.pending, desk.stage.toPicture(mouse)] : this.pending;
    const colour = desk.tool.colour || COLOURS.accent;
    stroke(c, placed, line, colour, { dash: [6, 4] });
    this.pending.forEach((p) => knob(c, placed, p, colour));
    if (desk.tool.closes && this.pending.length > 2) {
      const [x, y] = toScreen(placed, this.pending[0]);
      c.beginPath();
      c.arc(x, y, 8, 0, 2 * Math.PI);
      c.strokeStyle = "#fff";
      c.stroke();
    }
  }
}
