// Step 5: what is still wrong, and saving.

import { el, metres } from "./elements.js";
import { isGood, paintLanes } from "./lanes.js";
import { name } from "./pictures.js";
import * as server from "./server.js";

/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./main.js").Step} Step */

/** @param {Desk} desk */
async function run(desk) {
  desk.kept.saving = true;
  desk.kept.saveProblem = "";
  desk.render();
  try {
    desk.kept.saved = await server.save(desk.store.drawing);
    desk.store.changed = false;
  } catch (error) {
    desk.kept.saved = null;
    desk.kept.saveProblem = /** @type {Error} */ (error).message;
  }
  desk.kept.saving = false;
  desk.render();
}

/** @type {Step} */
export const step = {
  name: "Save",
  movable: [],
  tools: () => [],
  hint: () => "",
  done: (desk) => (!!desk.kept.saved || desk.site.saved) && !desk.store.changed && !desk.moved,
  paint: (desk, c, placed) => paintLanes(desk, c, placed, false),
  panel(desk) {
    const { drawing } = desk.store;
    const camera = desk.look?.camera;
    const checks = [
      check(!desk.moved, "The camera stands where it was drawn", "Confirm that the points are right"),
      check(camera?.trust === "ok", "The camera is known well enough", camera ? camera.trust : "Nothing says where the camera stands"),
      check(isGood(desk), `${drawing.lanes.length} lanes can be measured`, drawing.lanes.length ? "A lane is red: go back to the lanes" : "No lane is drawn"),
    ];
    const source = el("input", {
      type: "text", value: drawing.source, placeholder: "the folder of pictures", data: { key: "source" }, id: "source",
      oninput: () => desk.store.edit((d) => { d.source = source.value; }, "source"),
    });
    return [
      el("h2", { text: "Save the site" }),
      el("div", { class: "card" }, ...checks),
      el("h3", { text: "The sensor" }),
      name(desk, "Site", "site"),
      name(desk, "Camera", "camera_id"),
      el("label", { class: "row", title: "Address of the camera on the box; it is not asked now" }, el("span", { text: "Camera's address" }), source),
      el("label", { class: "row" }, el("span", { text: "Seconds between pictures" }), metres("interval", drawing.interval_s ?? desk.site.interval_s, (value) => desk.store.edit((d) => { d.interval_s = value; }, "interval"), "s")),
      el("div", { class: "actions" }, el("button", { class: "primary", id: "save", disabled: desk.kept.saving, onclick: () => run(desk) }, desk.kept.saving ? "Saving …" : "Save")),
      desk.kept.saveProblem && el("div", { class: "card bad", id: "save-problem", text: desk.kept.saveProblem }),
      ...saved(desk),
    ];
  },
};

/** @param {boolean} good @param {string} yes @param {string} no */
const check = (good, yes, no) =>
  el("div", { class: good ? "good-text" : "bad-text", text: good ? `✓ ${yes}` : `✗ ${no}` });

/** @param {Desk} desk */
function saved(desk) {
  /** @type {import("./types.js").Saved | null} */
  const result = desk.kept.saved ?? null;
  if (!result) return [];
  const folder = /\s/.test(result.folder) ? `"${result.folder}"` : result.folder;
  return [
    el("div", { class: "card good", id: "saved" }, el("b", { text: "Saved in " }), el("code", { text: result.folder })),
    desk.store.changed && el("p", { class: "fair-text", text: "Something was changed since." }),
    el("table", { class: "files" }, ...result.files.map(([file, what]) => el("tr", {}, el("td", {}, el("code", { text: file })), el("td", { class: "dim", text: what })))),
    el("h3", { text: "What comes next" }),
    el("div", { class: "actions" }, el("button", { class: "primary", id: "next", onclick: () => desk.go(5) }, "Audit the counts")),
    el("p", {}, el("code", { text: `verge check --config ${folder}/verge.toml` })),
    el("p", {}, el("code", { text: `verge replay --table ${folder}/lanes.lut --frames DIR` })),
  ];
}
