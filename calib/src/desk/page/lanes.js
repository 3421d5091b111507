// Step 3: the lanes, each with its number, its direction and what it measures.

import { el, many, percent } from "./elements.js";
import { area, arrow, COLOURS, knob, label, laneColour, middle, stroke } from "./paint.js";
import { distance, isInside, nearestOn } from "./tools.js";

/** @typedef {import("./types.js").Px} Px */
/** @typedef {import("./types.js").Handle} Handle */
/** @typedef {import("./types.js").Selection} Selection */
/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./main.js").Step} Step */
/** @typedef {import("./main.js").Tool} Tool */
/** @typedef {import("./tools.js").Hand} Hand */

/** How near a point is drawn onto a line, screen px. */
const SNAP = 9;
const MOST_LANES = 8;
const FULL = `${MOST_LANES} lanes are the most that the sensor counts of one camera. Remove one to draw another.`;
/** A double click's second point lies so near to its first, px of the picture. */
const SAME_PX = 1.5;

/** @param {Desk} desk */
const isFull = (desk) => desk.store.drawing.lanes.length >= MOST_LANES;

/** @param {Desk} desk */
function freeNumber(desk) {
  const taken = new Set(desk.store.drawing.lanes.map((l) => l.number));
  for (let n = 1; n <= MOST_LANES; n++) if (!taken.has(n)) return n;
  return MOST_LANES;
}

/** The direction that is set for new lanes: none until one was chosen. @param {Desk} desk @param {Px[]} polygon */
function addLane(desk, polygon) {
  if (isFull(desk)) return desk.say(FULL);
  const number = freeNumber(desk);
  desk.store.edit((d) => d.lanes.push({ number, direction: "", widens: false, polygon }));
  desk.select({ kind: "lane", index: desk.store.drawing.lanes.length - 1 });
}

/** @param {Desk} desk */
function takeAll(desk) {
  for (const strip of free(desk)) addLane(desk, strip.outline.map((p) => [p[0], p[1]]));
}

/** Whether a lane was drawn there already. @param {Desk} desk @param {Px[]} outline */
const isTaken = (desk, outline) => {
  const at = middle(outline);
  return desk.store.drawing.lanes.some((l) => isInside(at, l.polygon));
};

/** @param {Desk} desk */
const free = (desk) => (desk.look?.strips ?? []).filter((s) => s.outline.length > 3 && !isTaken(desk, s.outline));

/** @param {Desk} desk @returns {Tool[]} */
function tools(desk) {
  /** @type {(kind: "lane" | "ignored") => (hand: Hand) => void} */
  const close = (kind) => (hand) => {
    const points = hand.pending;
    const least = kind === "lane" ? 4 : 3;
    if (points.length > 1 && distance(points[points.length - 1], points[points.length - 2]) < SAME_PX) points.pop();
    if (points.length && points.length < least) desk.say(`${least} corners are the fewest: click on.`);
    if (points.length < least) return;
    hand.pending = [];
    if (kind === "lane") addLane(desk, points);
    else desk.store.edit((d) => d.ignored.push(points));
  };
  /** @type {(kind: "lane" | "ignored") => Tool["click"]} */
  const click = (kind) => (at, hand) => {
    if (kind === "lane" && isFull(desk)) return desk.say(FULL);
    const [first] = hand.pending;
    const closes = hand.pending.length > 2 && first && distance(at, first) * desk.stage.placed.scale < SNAP;
    if (closes) close(kind)(hand);
    else hand.pending.push(at);
  };
  return [
    {
      name: "Between lines", key: "L", colour: COLOURS.accent, takes: "lane",
      hint: "Click between two lane lines: the lane takes their shape, as far as vehicles are seen well.",
      click(at) {
        const strip = free(desk).find((s) => isInside(at, s.outline));
        if (strip) addLane(desk, strip.outline.map((p) => [p[0], p[1]]));
        else desk.select(under(desk, at));
      },
    },
    {
      name: "Outline", key: "P", colour: COLOURS.accent, takes: "lane", closes: true,
      hint: "Click the corners of one lane in order; they snap to lines and corners (Alt: not). Enter or the first corner closes it.",
      click: click("lane"), finish: close("lane"),
    },
    {
      name: "Ignore", key: "I", colour: COLOURS.ignored, takes: "ignored", closes: true,
      hint: "Outline what is burnt into the picture (clock, logo) or moves for ever (a tree): it is no part of the scene.",
      click: click("ignored"), finish: close("ignored"),
    },
  ];
}

/** @param {Desk} desk @param {Px} at @returns {Selection} */
export function under(desk, at) {
  const { lanes, ignored } = desk.store.drawing;
  const lane = lanes.findIndex((l) => isInside(at, l.polygon));
  if (lane >= 0) return { kind: "lane", index: lane };
  const other = ignored.findIndex((p) => isInside(at, p));
  return other >= 0 ? { kind: "ignored", index: other } : null;
}

/** @param {Desk} desk @param {Px} at */
export function hover(desk, at) {
  const strip = desk.tool?.name === "Between lines" && free(desk).find((s) => isInside(at, s.outline));
  desk.kept.strip = strip || null;
}

/**
 * The place of a point on a line or corner nearby, else its own.
 * @param {Desk} desk @param {Px} at @param {Handle} [held]
 * @returns {Px}
 */
export function snapped(desk, at, held) {
  if (desk.tool?.name === "Ignore" || held?.kind === "ignored") return at;
  const { drawing } = desk.store;
  const reach = SNAP / desk.stage.placed.scale;
  const others = drawing.lanes.flatMap((l, k) => (held?.kind === "lane" && held.index === k ? [] : l.polygon));
  const corners = [...others, ...drawing.lines.flatMap((l) => l.points)];
  const corner = corners.find((p) => distance(p, at) < reach);
  if (corner) return [corner[0], corner[1]];
  for (const { points } of drawing.lines) {
    const on = nearestOn(at, points);
    if (on && distance(on, at) < reach) return on;
  }
  return at;
}

/** @param {Desk} desk @param {number} index @param {string} direction */
function direct(desk, index, direction) {
  desk.store.edit((d) => { d.lanes[index].direction = direction; });
}

/** @type {Step} */
export const step = {
  name: "Lanes",
  movable: ["lane", "ignored"],
  tools,
  hint: () => "Drag corners to mend them. T and A set the selected lane's direction: toward the camera, away from it.",
  done: (desk) => isGood(desk),
  key(desk, key) {
    const chosen = desk.selection?.kind === "lane" ? desk.selection.index : -1;
    if (chosen < 0 || (key !== "t" && key !== "a")) return false;
    direct(desk, chosen, key === "t" ? "toward" : "away");
    return true;
  },
  panel(desk) {
    const { drawing } = desk.store;
    const waiting = free(desk).length;
    const undirected = drawing.lanes.some((l) => !l.direction);
    const all = (/** @type {string} */ direction) => desk.store.edit((d) => d.lanes.forEach((l) => { l.direction = l.direction || direction; }));
    return [
      el("h2", { text: "The lanes" }),
      !desk.look?.camera && el("div", { class: "card bad", text: "There is no camera yet: lanes are measured once the road is." }),
      desk.look?.lanes_problem ? el("div", { class: "card bad", id: "lanes-problem", text: desk.look.lanes_problem }) : null,
      isFull(desk) && el("p", { class: "fair-text", id: "lanes-full", text: FULL }),
      !drawing.lanes.length && el("p", { class: "dim", text: waiting ? "Click between the lane lines, or take all of them at once." : "Outline each lane by itself." }),
      waiting > 0 && el("button", { class: "primary", id: "all-lanes", onclick: () => takeAll(desk) }, waiting === 1 ? "Take the one between the lines" : `Take all ${waiting} between the lines`),
      undirected && drawing.lanes.length > 1 && el("div", { class: "actions" },
        el("span", { class: "dim", text: "All that have no direction:" }),
        el("button", { class: "small", id: "all-toward", onclick: () => all("toward") }, "↓ toward"),
        el("button", { class: "small", id: "all-away", onclick: () => all("away") }, "↑ away")),
      el("div", { class: "list", id: "lanes" }, ...drawing.lanes.map((_, index) => laneItem(desk, index))),
      drawing.ignored.length > 0 && el("h3", { text: "Ignored" }),
      el("div", { class: "list" }, ...drawing.ignored.map((p, index) => el("div", { class: "item", onclick: () => desk.select({ kind: "ignored", index }) },
        el("span", { class: "swatch" }), el("span", { class: "dim", text: many(p.length, "corner") }),
        el("button", { class: "close", "aria-label": `remove ignored ${index + 1}`, onclick: () => { desk.selection = { kind: "ignored", index }; desk.remove(); } }, "×")))),
      el("div", { class: "actions" },
        el("button", { class: isGood(desk) ? "primary" : "", id: "next", onclick: () => desk.go(3) }, "See it count")),
    ];
  },
  paint(desk, c, placed) {
    const { drawing } = desk.store;
    for (const { points } of drawing.lines) stroke(c, placed, points, "#59b7ff90", { width: 1 });
    const { strip } = desk.kept;
    if (strip) area(c, placed, strip.outline, COLOURS.accent, "#35c2ad40");
    paintLanes(desk, c, placed, true);
    drawing.ignored.forEach((polygon, k) => {
      area(c, placed, polygon, COLOURS.ignored, "#00000070");
      polygon.forEach((p) => knob(c, placed, p, COLOURS.ignored, desk.selection?.kind === "ignored" && desk.selection.index === k));
    });
  },
};

/** Whether every lane can be used. @param {Desk} desk */
export function isGood(desk) {
  const { look, store } = desk;
  return store.drawing.lanes.length > 0 && !!look && !look.lanes_problem
    && look.lanes.length === store.drawing.lanes.length && look.lanes.every((l) => !l.problem);
}

/** @param {Desk} desk @param {CanvasRenderingContext2D} c @param {import("./stage.js").Placed} placed @param {boolean} knobs */
export function paintLanes(desk, c, placed, knobs) {
  const { look, selection } = desk;
  desk.store.drawing.lanes.forEach((lane, k) => {
    const chosen = selection?.kind === "lane" && selection.index === k;
    const bad = look?.lanes[k]?.problem;
    const colour = bad ? COLOURS.bad : laneColour(lane.number);
    area(c, placed, lane.polygon, colour, `${colour}${chosen ? "50" : knobs ? "30" : "18"}`);
    const line = look?.lanes[k]?.measured?.middle ?? [];
    if (lane.direction) arrow(c, placed, line, colour);
    if (knobs) lane.polygon.forEach((p) => knob(c, placed, p, colour, chosen));
    const near = [...lane.polygon].sort((a, b) => b[1] - a[1]).slice(0, 2);
    label(c, placed, middle(near), String(lane.number), colour, -14);
  });
}

/** @param {Desk} desk @param {number} index */
function laneItem(desk, index) {
  const lane = desk.store.drawing.lanes[index];
  const measured = desk.look?.lanes[index]?.measured;
  const problem = desk.look?.lanes[index]?.problem;
  const chosen = desk.selection?.kind === "lane" && desk.selection.index === index;
  const colour = problem ? COLOURS.bad : laneColour(lane.number);
  const number = el("select", { "aria-label": "number of the lane", onchange: () => desk.store.edit((d) => { d.lanes[index].number = Number(number.value); }) },
    ...Array.from({ length: MOST_LANES }, (_, k) => el("option", { value: String(k + 1), text: String(k + 1) })));
  number.value = String(lane.number);
  const swatch = el("span", { class: "swatch", text: lane.direction === "toward" ? "↓" : lane.direction === "away" ? "↑" : "?" });
  swatch.style.background = colour;
  const way = (/** @type {string} */ direction, /** @type {string} */ text) =>
    el("button", { class: "small", data: { way: direction }, "aria-pressed": String(lane.direction === direction), onclick: () => direct(desk, index, direction) }, text);
  return el("div", {
    class: `item ${chosen ? "selected" : ""} ${problem ? "bad" : ""}`, data: { lane: String(lane.number) },
    onclick: (/** @type {MouseEvent} */ e) => { if (!(e.target instanceof HTMLButtonElement || e.target instanceof HTMLSelectElement)) desk.select({ kind: "lane", index }); },
  },
  swatch,
  el("span", { class: "controls" }, number, way("toward", "↓ toward"), way("away", "↑ away")),
  el("button", { class: "close", title: "Remove", "aria-label": `remove lane ${lane.number}`, onclick: () => { desk.selection = { kind: "lane", index }; desk.remove(); } }, "×"),
  measured && el("span", { class: "wide", text: `${measured.length_m.toFixed(1)} m long${measured.rel_err === null ? "" : ` ± ${percent(measured.rel_err)}`}, ${measured.near_width_m.toFixed(2)} m wide near, ${measured.far_width_m.toFixed(2)} m far; 1 px is ${measured.far_span_m.toFixed(2)} m at its end` }),
  problem && el("span", { class: "wide bad-text problem", text: problem }),
  problem && problem.includes("widens") && el("label", { class: "row wide" },
    el("input", { type: "checkbox", checked: lane.widens, onchange: () => desk.store.edit((d) => { d.lanes[index].widens = !d.lanes[index].widens; }) }),
    el("span", { text: "the road is wider here, this is one lane" })));
}
