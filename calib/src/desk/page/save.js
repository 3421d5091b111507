// Step 5: what is still wrong, and saving.

import { el, many } from "./elements.js";
import { interval, row, wrongFields } from "./fields.js";
import { isGood, paintLanes } from "./lanes.js";
import { name } from "./pictures.js";
import { isOff } from "./road.js";
import * as server from "./server.js";

/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./main.js").Step} Step */

/** @param {Desk} desk */
async function run(desk) {
  const { kept, store } = desk;
  // What is being measured anew is judged by the program alone.
  const isKnown = !desk.isStale && !desk.isLooking;
  const refused = [...wrongNumbers(desk), ...(isKnown ? cameraProblems(desk) : [])];
  kept.saveProblem = refused.length ? `Not saved: ${refused.join("; ")}` : "";
  if (!refused.length) {
    const sent = JSON.stringify(store.drawing);
    kept.saving = true;
    desk.render();
    try {
      /** @type {import("./types.js").Saved} */
      const saved = await server.save(store.drawing, desk.version);
      kept.saved = saved;
      desk.version = saved.version;
      desk.site.draft = false;
      desk.site.aside = null;
      store.saved(sent);
    } catch (error) {
      kept.saved = null;
      kept.saveProblem = /** @type {Error} */ (error).message;
    }
    kept.saving = false;
  }
  desk.render();
}

/** @param {Desk} desk */
const wrongNumbers = (desk) =>
  wrongFields(desk).map(({ field, text, why }) => `${field.name(desk.store.drawing)} is “${text}”: ${why}`);

/** What forbids to save the camera, in the program's words. @param {Desk} desk @returns {string[]} */
function cameraProblems(desk) {
  const { look } = desk;
  if (!look) return ["nothing is measured yet"];
  const { camera } = look;
  const said = [look.problem, camera && camera.trust !== "ok" ? camera.trust : "", ...(look.problems ?? [])];
  look.lengths.forEach((fit, k) => {
    if (fit?.is_contradicted && !said.some((text) => text?.includes(fit.doubt ?? ""))) said.push(`Length ${k + 1}: ${fit.doubt}`);
  });
  const problems = [...new Set(said.flatMap((text) => text || []))];
  return camera || problems.length ? problems : ["nothing says where the camera stands"];
}

/** Lengths that are red in the list of the road, though the camera may be saved. @param {Desk} desk */
const offLengths = (desk) => (desk.look?.lengths ?? []).flatMap((fit, k) => (isOff(fit) && !fit?.is_contradicted ? k + 1 : []));

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
    const problems = cameraProblems(desk);
    const off = offLengths(desk);
    const n = drawing.lanes.length;
    const checks = [
      check(!desk.moved, "The camera stands where it was drawn", "Confirm that the points are right"),
      ...(problems.length ? problems : [""]).map((problem) => check(!problem, "The camera is known well enough", problem)),
      off.length > 0 && el("div", { class: "fair-text", text: `! Red on the road: length ${off.join(", ")}. Look at its ends and its metres.` }),
      check(isGood(desk), `${many(n, "lane")} can be measured`, n ? "A lane is red: go back to the lanes" : "No lane is drawn"),
      ...wrongNumbers(desk).map((problem) => check(false, "", problem)),
    ];
    const source = el("input", {
      type: "text", value: drawing.source, placeholder: "the folder of pictures", data: { key: "source" }, id: "source",
      oninput: () => desk.store.edit((d) => { d.source = source.value; }, "source"),
    });
    return [
      el("h2", { text: "Save the site" }),
      el("div", { class: "card", id: "checks" }, ...checks),
      el("h3", { text: "The sensor" }),
      name(desk, "Site", "site"),
      name(desk, "Camera", "camera_id"),
      el("label", { class: "row", title: "Address of the camera on the box; it is not asked now" }, el("span", { text: "Camera's address" }), source),
      ...row(desk, interval, desk.site.interval_s),
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
