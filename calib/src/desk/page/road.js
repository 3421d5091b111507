// Step 2: what is known of the road, and the camera that follows from it.

import { carFigure } from "./car.js";
import { dashes } from "./dashes.js";
import { el, many, percent } from "./elements.js";
import * as fields from "./fields.js";
import { COLOURS, dots, errorColour, knob, label, middle, stroke } from "./paint.js";
import { distance } from "./tools.js";

/** @typedef {import("./types.js").Px} Px */
/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./main.js").Step} Step */
/** @typedef {import("./main.js").Tool} Tool */
/** @typedef {import("./tools.js").Hand} Hand */

/** A length whose residual is beyond so many standard deviations contradicts the others. */
const CONTRADICTION = 4;
const KEY_POINTS = 13;
/** A double click's second point lies so near to its first, px of the picture. */
const SAME_PX = 1.5;

/** @param {import("./types.js").LengthLook | null | undefined} fit */
export const isOff = (fit) => !!fit && fit.in_sd > CONTRADICTION;

/** @param {Desk} desk @returns {Tool[]} */
function tools(desk) {
  /** @param {Hand} hand */
  const endLine = (hand) => {
    const points = hand.pending;
    // A double click sets its point twice.
    if (points.length > 1 && distance(points[points.length - 1], points[points.length - 2]) < SAME_PX) points.pop();
    if (points.length === 1) desk.say("A line needs two points.");
    if (points.length < 2) return;
    hand.pending = [];
    const id = 1 + Math.max(0, ...desk.store.drawing.lines.map((l) => l.id));
    desk.store.edit((d) => d.lines.push({ id, points }));
    desk.select({ kind: "line", index: desk.store.drawing.lines.length - 1 });
  };
  return [
    {
      name: "Length", key: "L", colour: COLOURS.length, takes: "length", begins: true,
      hint: "Click both ends of a known length on the road, then type its metres. First one along the road near the camera, then one far from it. An end that is there can be dragged, and a click on it begins the next length.",
      click(at, hand) {
        if (hand.pending.length && distance(hand.pending[0], at) < SAME_PX) return;
        hand.pending.push(at);
        if (hand.pending.length < 2) return;
        const points = hand.pending;
        hand.pending = [];
        desk.store.edit((d) => d.lengths.push({ points, metres: null, standard: null }));
        const index = desk.store.drawing.lengths.length - 1;
        desk.select({ kind: "length", index });
        const input = /** @type {HTMLInputElement | null} */ (document.querySelector(`[data-key="length-${index}"]`));
        input?.focus();
      },
    },
    {
      name: "Lane line", key: "N", colour: COLOURS.line, takes: "line",
      hint: "Click along a lane's line from near to far, Enter or double click ends it. Two lines side by side make a lane.",
      click: (at, hand) => void hand.pending.push(at),
      finish: endLine,
    },
    {
      name: "Rectangle", key: "R", colour: COLOURS.rectangle, takes: "rectangle", closes: true,
      hint: "Click the four corners of a right angle on the road, in order: a stop line's box, a parking bay.",
      click(at, hand) {
        hand.pending.push(at);
        if (hand.pending.length < 4) return;
        const [a, b, c, d4] = hand.pending;
        hand.pending = [];
        desk.store.edit((d) => d.rectangles.push([a, b, c, d4]));
        desk.select({ kind: "rectangle", index: desk.store.drawing.rectangles.length - 1 });
      },
    },
    {
      name: "Vehicle", key: "K", colour: COLOURS.vehicle, takes: "vehicle",
      hint: "Click the point of the vehicle that is lit in the drawing beside; what is hidden is skipped by choosing another number there. Four are the least, seven are good.",
      click(at) {
        const { drawing } = desk.store;
        const chosen = desk.selection?.kind === "vehicle" ? desk.selection.index : -1;
        if (chosen < 0) {
          desk.store.edit((d) => d.vehicles.push({ body: "car", points: { [nextKey(desk)]: at } }));
          desk.select({ kind: "vehicle", index: drawing.vehicles.length - 1 });
        } else {
          const key = nextKey(desk);
          if (key === 0) return;
          desk.store.edit((d) => { d.vehicles[chosen].points[key] = at; });
        }
        desk.kept.key = 0;
        desk.render();
      },
      finish: () => desk.select(null),
    },
  ];
}

/** The key point that is set next: the one that was chosen, else the first that is missing. @param {Desk} desk */
function nextKey(desk) {
  if (desk.kept.key) return desk.kept.key;
  const chosen = desk.selection?.kind === "vehicle" ? desk.store.drawing.vehicles[desk.selection.index] : null;
  for (let key = 1; key <= KEY_POINTS; key++) if (!chosen?.points[key]) return key;
  return 0;
}

/** @type {Step} */
export const step = {
  name: "Road",
  movable: ["length", "line", "rectangle", "vehicle"],
  tools,
  hint: () => "Drag points to mend them; arrow keys move by a quarter of a pixel; Delete removes what is selected.",
  done: (desk) => desk.look?.camera?.trust === "ok",
  panel: (desk) => [
    el("h2", { text: "The road" }),
    cameraCard(desk),
    ...lengths(desk),
    ...rectangles(desk),
    ...lines(desk),
    ...known(desk),
    ...vehicles(desk),
    el("div", { class: "actions" },
      el("button", { class: step.done(desk) ? "primary" : "", id: "next", onclick: () => desk.go(2) }, "Draw the lanes"),
    ),
  ],
  paint(desk, c, placed) {
    const { drawing } = desk.store;
    const { look, selection } = desk;
    const isChosen = (/** @type {string} */ kind, /** @type {number} */ k) => selection?.kind === kind && selection.index === k;
    if (look?.camera) dots(c, placed, look.dots);
    for (const { points } of drawing.lines) stroke(c, placed, points, COLOURS.line);
    drawing.lines.forEach((l, k) => l.points.forEach((p) => knob(c, placed, p, COLOURS.line, isChosen("line", k))));
    drawing.rectangles.forEach((r, k) => {
      stroke(c, placed, r, COLOURS.rectangle, { closed: true });
      r.forEach((p) => knob(c, placed, p, COLOURS.rectangle, isChosen("rectangle", k)));
    });
    drawing.lengths.forEach((s, k) => {
      const fit = look?.lengths[k];
      const colour = isOff(fit) || fit?.is_contradicted ? COLOURS.bad : COLOURS.length;
      stroke(c, placed, s.points, colour, { width: 2.5 });
      s.points.forEach((p) => knob(c, placed, p, colour, isChosen("length", k)));
      label(c, placed, middle(s.points), s.metres ? `${k + 1}: ${s.metres} m` : s.standard ? `${k + 1}: ${s.standard}` : `${k + 1}: ? m`, colour, -16);
    });
    drawing.vehicles.forEach((v, k) => {
      const bad = look?.vehicles[k]?.problem && Object.keys(v.points).length > 3;
      for (const [key, p] of Object.entries(v.points)) {
        knob(c, placed, p, bad ? COLOURS.bad : COLOURS.vehicle, isChosen("vehicle", k));
        label(c, placed, p, key, COLOURS.vehicle, -14);
      }
    });
  },
};

/** @param {Desk} desk */
function cameraCard(desk) {
  const { look } = desk;
  const camera = look?.camera;
  if (!camera) {
    const problem = look?.problem ?? "";
    const isNew = problem.startsWith("nothing to calibrate");
    return el("div", { class: `card ${isNew || !problem ? "" : "bad"}`, id: "camera-card" }, isNew || !problem
      ? "Mark a known length along the road near the camera, and one far from it. A dash and its gap will do. Lane lines make it surer."
      : problem);
  }
  const good = camera.trust === "ok";
  const names = ["near", "middle", "far"];
  return el("div", { class: `card ${good ? "good" : "bad"}`, id: "camera-card" },
    el("div", { class: `big ${good ? "" : "bad-text"}`, text: `Lengths ± ${percent(camera.whole)}` }),
    !good && el("div", { class: "bad-text", id: "trust", text: camera.trust }),
    el("div", { class: "facts" },
      el("span", {}, el("b", { text: `${camera.height_m.toFixed(1)} m` }), " high"),
      el("span", {}, el("b", { text: `${camera.tilt_deg.toFixed(1)}°` }), " down"),
      el("span", {}, "f ", el("b", { text: `${camera.f_px.toFixed(0)} px` })),
      el("span", { title: "Time that the fit took" }, `${look.fit_ms.toFixed(0)} ms`),
    ),
    el("div", { class: "bars" }, ...camera.errors.flatMap((e, k) => {
      const fillBar = el("i");
      fillBar.style.width = `${Math.min(100, (100 * e.along) / camera.limits.along)}%`;
      fillBar.style.background = errorColour(e.along);
      return [el("span", { class: "dim", text: names[k] }), el("span", { class: "bar" }, fillBar), el("span", { class: "value", text: `± ${percent(e.along)}` })];
    })),
    el("div", { class: "facts", id: "across", title: `Of a stretch of 6 m across the road: beyond ${percent(camera.limits.across)} a vehicle could count in the wrong lane` },
      el("span", { class: "dim", text: "across the road" }),
      ...camera.errors.map((e, k) => el("span", { class: e.across > camera.limits.across ? "bad-text" : "", text: `${names[k]} ± ${percent(e.across)}` }))),
    camera.traffic && el("div", { class: "dim", text: `${many(camera.traffic.used, "vehicle agrees", "vehicles agree")}; cars here would be ${(100 * camera.traffic.longer).toFixed(1)} % longer than most fleets (± ${(100 * camera.traffic.longer_sd).toFixed(1)} %)` }),
  );
}

/** @param {Desk} desk */
function lengths(desk) {
  const { drawing } = desk.store;
  if (!drawing.lengths.length) return [];
  return [
    el("h3", { text: "Lengths" }),
    el("div", { class: "list", id: "lengths" }, ...drawing.lengths.map((s, index) => {
      const fit = desk.look?.lengths[index];
      const off = isOff(fit);
      const field = fields.metresOf(s, index);
      const wrong = s.standard === null ? fields.reason(desk, field) : null;
      const select = el("select", {
        "aria-label": `length ${index + 1}: measured or a standard`, title: "A tape's length, or dash and gap as a country paints them",
        onchange: () => desk.store.edit((d) => { d.lengths[index].standard = select.value || null; }),
      },
      el("option", { value: "", text: "measured" }),
      ...desk.site.standards.map((t) => el("option", { value: t.name, title: `${t.what}: ${t.pitch_m.toFixed(2)} m from dash to dash`, text: `${t.name} (${t.pitch_m.toFixed(1)} m)` })));
      select.value = s.standard ?? "";
      return item(desk, "length", index, COLOURS.length, String(index + 1), off || fit?.is_contradicted || wrong ? "bad" : "",
        el("span", { class: "controls" },
          s.standard === null && fields.input(desk, field),
          select,
        ),
        wrong,
        fit ? el("span", { class: `wide ${off ? "bad-text" : "dim"}`, text: `measures ${fit.measured_m.toFixed(2)} m, ${percent(Math.abs(fit.measured_m / fit.known_m - 1))} ${fit.measured_m > fit.known_m ? "more" : "less"} (${fit.in_sd.toFixed(1)} sd)${off && !fit.doubt ? ": look at its ends and its metres" : ""}` })
          : s.standard === null && s.metres === null && !wrong ? el("span", { class: "wide fair-text", text: "type its metres" }) : null,
        fit?.doubt ? el("span", { class: `wide ${fit.is_contradicted ? "bad-text" : "fair-text"}`, id: `doubt-${index}`, text: fit.doubt }) : null,
      );
    })),
  ];
}

/**
 * @param {Desk} desk @param {import("./types.js").Handle["kind"]} kind @param {number} index
 * @param {string} colour @param {string} mark @param {string} state @param {Node} main @param {(Node | null)[]} more
 */
function item(desk, kind, index, colour, mark, state, main, ...more) {
  const swatch = el("span", { class: "swatch", text: mark });
  swatch.style.background = colour;
  const chosen = desk.selection?.kind === kind && desk.selection.index === index;
  return el("div", { class: `item ${chosen ? "selected" : ""} ${state}`, onclick: (/** @type {MouseEvent} */ e) => { if (!(e.target instanceof HTMLInputElement || e.target instanceof HTMLSelectElement || e.target instanceof HTMLButtonElement)) desk.select({ kind, index }); } },
    swatch, main,
    el("button", { class: "close", title: "Remove", "aria-label": `remove ${kind} ${index + 1}`, onclick: () => { desk.selection = { kind, index }; desk.remove(); } }, "×"),
    ...more);
}

/** @param {Desk} desk */
function rectangles(desk) {
  const { drawing } = desk.store;
  if (!drawing.rectangles.length) return [];
  return [
    el("h3", { text: "Rectangles" }),
    el("div", { class: "list", id: "rectangles" }, ...drawing.rectangles.map((_, index) => {
      const fit = desk.look?.rectangles[index];
      const off = fit && fit.in_sd > CONTRADICTION;
      const main = fit
        ? el("span", { class: off ? "bad-text" : "dim", text: `${fit.sides_m[0].toFixed(2)} by ${fit.sides_m[1].toFixed(2)} m, ${fit.angle_deg.toFixed(0)}° (${fit.in_sd.toFixed(1)} sd)${off ? ": look at its corners" : ""}` })
        : el("span", { class: "dim", text: "right angles" });
      return item(desk, "rectangle", index, COLOURS.rectangle, String(index + 1), off ? "bad" : "", main);
    })),
  ];
}

/** @param {Desk} desk */
function lines(desk) {
  const { drawing } = desk.store;
  if (!drawing.lines.length) return [];
  const place = new Map(drawing.lines.map((l, k) => [l.id, k + 1]));
  return [
    el("h3", { text: "Lane lines" }),
    el("div", { class: "list" },
      ...drawing.lines.map((l, index) => item(desk, "line", index, COLOURS.line, String(index + 1), "", el("span", { class: "dim", text: many(l.points.length, "point") }), null)),
      ...(desk.look?.strips ?? []).map((s) => {
        const [a, b] = s.lines.map((id) => place.get(id) ?? 0);
        const width = s.width_m;
        return el("label", { class: "row", title: "Off where there is no lane between these lines" },
          el("input", { type: "checkbox", checked: true, onchange: () => desk.store.edit((d) => { d.apart.push([s.lines[0], s.lines[1]]); }) }),
          el("span", { text: `a lane between ${a} and ${b}` }),
          width && el("span", { class: width[1] > 5.5 || width[1] < 1.8 ? "bad-text" : "", title: s.width_err ? `near ± ${percent(s.width_err[0])}, middle ± ${percent(s.width_err[1])}, far ± ${percent(s.width_err[2])}` : "", text: `${width[1].toFixed(2)} m${s.width_err ? ` ± ${(s.width_err[1] * width[1]).toFixed(2)} m` : ""}` }));
      }),
      ...drawing.apart.filter((pair) => pair.every((id) => place.has(id))).map((pair) =>
        el("label", { class: "row" },
          el("input", { type: "checkbox", onchange: () => desk.store.edit((d) => { d.apart = d.apart.filter((p) => p[0] !== pair[0] || p[1] !== pair[1]); }) }),
          el("span", { text: `no lane between ${place.get(pair[0])} and ${place.get(pair[1])}` }))),
    ),
    ...dashes(desk),
  ];
}

/** @param {Desk} desk */
function known(desk) {
  const { drawing } = desk.store;
  const { traffic } = desk.site;
  return [
    el("h3", { text: "Known besides" }),
    ...fields.row(desk, fields.laneWidth),
    ...fields.row(desk, fields.cameraHeight),
    traffic.state === "done" && el("label", { class: "row" },
      el("input", { type: "checkbox", checked: drawing.use_traffic, onchange: () => desk.store.edit((d) => { d.use_traffic = !d.use_traffic; }) }),
      el("span", { text: `the vehicles found in ${many(traffic.frames, "picture")} (needs lane lines)` })),
  ];
}

/** @param {Desk} desk */
function vehicles(desk) {
  const { drawing } = desk.store;
  if (!drawing.vehicles.length && desk.tool?.name !== "Vehicle") return [];
  const chosen = desk.selection?.kind === "vehicle" ? desk.selection.index : -1;
  const points = drawing.vehicles[chosen]?.points ?? {};
  return [
    el("h3", { text: "Vehicles with key points" }),
    carFigure(desk.site.key_points, points, nextKey(desk), (key) => { desk.kept.key = key; desk.render(); }),
    el("div", { class: "list" }, ...drawing.vehicles.map((v, index) => {
      const fit = desk.look?.vehicles[index];
      const select = el("select", { "aria-label": `vehicle ${index + 1} is a`, onchange: () => desk.store.edit((d) => { d.vehicles[index].body = select.value; }) },
        ...["car", "taxi", "van", "minibus"].map((body) => el("option", { value: body, text: body })));
      select.value = v.body;
      const few = Object.keys(v.points).length < 4;
      return item(desk, "vehicle", index, COLOURS.vehicle, String(index + 1), fit?.problem && !few ? "bad" : "",
        el("span", { class: "controls" }, select, el("span", { class: "dim", text: many(Object.keys(v.points).length, "point") })),
        fit?.problem ? el("span", { class: `wide ${few ? "dim" : "bad-text"}`, text: few ? "four points are the least" : fit.problem })
          : fit?.misfit_px ? el("span", { class: "wide dim", text: `its points miss their fit by ${fit.misfit_px.toFixed(2)} px` }) : null);
    })),
    chosen >= 0 && el("button", { class: "small", onclick: () => desk.select(null) }, "Begin another vehicle"),
  ];
}
