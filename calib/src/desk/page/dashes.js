// The dashes of the drawn lines, found in the picture without traffic: lengths that nobody clicks.

import { el, many } from "./elements.js";
import * as server from "./server.js";

/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./types.js").Length} Length */

/** A length that begins so close to a found one is the same, px. */
const SAME_PX = 6;

/** @param {Length} length @param {import("./types.js").Px[]} points */
const isSame = (length, points) =>
  length.points.length > 2 && Math.hypot(length.points[0][0] - points[0][0], length.points[0][1] - points[0][1]) < SAME_PX;

/** @param {Desk} desk */
async function look(desk) {
  const { kept, store } = desk;
  kept.dashes = ["…"];
  desk.render();
  try {
    const found = await server.dashes(store.drawing);
    const number = (/** @type {number} */ id) => 1 + store.drawing.lines.findIndex((l) => l.id === id);
    const good = found.filter((f) => f.points.length);
    if (good.length) {
      store.edit((d) => good.forEach(({ points }) => {
        const standard = kept.pitch || null;
        const old = d.lengths.find((l) => isSame(l, points));
        if (old) Object.assign(old, { points, standard: standard ?? old.standard });
        else d.lengths.push({ points, metres: null, standard });
      }));
    }
    kept.dashes = found.map((f) => f.pitch_m === null
      ? `line ${number(f.line)}: ${f.problem}`
      : `line ${number(f.line)}: ${many(f.points.length, "dash", "dashes")}, ${f.pitch_m.toFixed(1)} m from one to the next as the camera is known now`);
  } catch (error) {
    kept.dashes = [/** @type {Error} */ (error).message];
  }
  desk.render();
}

/** The row of the panel below the lane lines. @param {Desk} desk */
export function dashes(desk) {
  const { kept, site } = desk;
  const select = el("select", {
    id: "dash-standard", "aria-label": "what the dashes are", title: "From the start of one dash to the start of the next, as a country paints them",
    onchange: () => { kept.pitch = select.value; },
  },
  el("option", { value: "", text: "metres typed later" }),
  ...site.standards.map((t) => el("option", { value: t.name, title: t.what, text: `${t.name} (${t.pitch_m.toFixed(1)} m)` })));
  select.value = kept.pitch ?? "";
  return [
    el("div", { class: "row" },
      el("button", { class: "small", id: "find-dashes", title: "Looks along each line in the picture without traffic", onclick: () => void look(desk) }, "Find dashes"),
      select),
    ...(kept.dashes ?? []).map((/** @type {string} */ text) => el("div", { class: "dim dashes", text })),
  ];
}
