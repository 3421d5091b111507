// Step 1: the pictures, and what the site and its camera are called.

import { el, many } from "./elements.js";
import { pictureAddress } from "./server.js";
import { isBlank } from "./store.js";

/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./main.js").Step} Step */

/** Most pictures that are listed. */
const MOST = 24;

/** Names a new site after its folder. @param {import("./types.js").Site} site */
export function prefill({ drawing, folder, source }) {
  const parts = folder.split("/").filter((part) => part && !["site", "frames", "."].includes(part));
  const name = (parts.pop() ?? "camera").replace(/[^\p{L}\p{N}_.-]/gu, "-").slice(0, 24);
  if (!drawing.site) drawing.site = name;
  if (!drawing.camera_id) drawing.camera_id = name;
  if (!drawing.source && source) drawing.source = source;
}

/** @type {Step} */
export const step = {
  name: "Pictures",
  movable: [],
  tools: () => [],
  paint: () => {},
  hint: () => "Is the road in view, and is the picture without traffic free of vehicles?",
  done: (desk) => desk.at > 0 || !isBlank(desk.store.drawing),
  panel(desk) {
    const { site } = desk;
    const out = new Map(site.left_out);
    const stride = Math.max(1, Math.ceil(site.frames.length / MOST));
    const listed = site.frames.filter((name, k) => k % stride === 0 || out.has(name)).slice(0, MOST);
    const few = site.used.length < 7;
    return [
      el("h2", { text: "Pictures" }),
      el("p", { class: "dim" }, `${many(site.frames.length, "picture")} of ${site.image_size.join(" × ")} px in the folder.`),
      el("div", { class: `card ${few ? "fair" : "good"}` },
        site.used.length === 1 ? "The picture without traffic is one of them as it is."
          : `The picture without traffic is the median of ${site.used.length} of them, brought over each other.`,
        few && el("div", { class: "fair-text", text: "With so few, vehicles may stay in it: " + (site.camera ? "collect more." : "put more pictures into the folder.") }),
      ),
      out.size > 0 && el("div", { class: "card fair", id: "left-out" },
        el("b", { text: `${out.size} left out. ` }),
        ...[...out].slice(0, 4).map(([name, why]) => el("div", { class: "dim", text: `${name}: ${why}` })),
      ),
      el("h3", { text: "Names" }),
      name(desk, "Site", "site"),
      name(desk, "Camera", "camera_id"),
      el("div", { class: "actions" },
        el("button", { class: "primary", id: "next", onclick: () => desk.go(1) }, "Measure the road"),
        site.camera && el("button", {
          id: "more", disabled: desk.store.changed, title: desk.store.changed ? "Save first: what is drawn goes onto the new pictures" : "",
          onclick: () => { location.hash = "collect"; location.reload(); },
        }, "Collect more"),
      ),
      el("h3", { text: "With traffic" }),
      el("div", { class: "thumbs" }, ...listed.map((file) => {
        const image = el("img", { src: pictureAddress(file), loading: "lazy", alt: file });
        const k = site.frames.indexOf(file);
        return el("button", { class: out.has(file) ? "out" : "", title: file, onclick: () => desk.show(k) }, image);
      })),
    ];
  },
};

/** @param {Desk} desk @param {string} text @param {"site" | "camera_id"} field */
export function name(desk, text, field) {
  const input = el("input", {
    type: "text", maxlength: 48, value: desk.store.drawing[field], data: { key: field }, id: field,
    oninput: () => desk.store.edit((d) => { d[field] = input.value; }, field),
  });
  return el("label", { class: "row" }, el("span", { text }), input);
}
