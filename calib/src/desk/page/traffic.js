// Step 4: the pictures as the sensor sees them: boxes, contact points, counts by lane.

import { el, many } from "./elements.js";
import { paintLanes } from "./lanes.js";
import { laneColour, vehicleBox } from "./paint.js";
import * as server from "./server.js";

/** @typedef {import("./types.js").Counts} Counts */
/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./main.js").Step} Step */

/** Pictures a second, when played. */
const PER_S = 2;
const POLL_MS = 1000;

/** @param {Desk} desk */
async function poll(desk) {
  clearTimeout(desk.kept.polling);
  const before = desk.site.traffic.state;
  try {
    desk.site.traffic = await server.traffic();
  } catch (error) {
    desk.kept.countProblem = /** @type {Error} */ (error).message;
  }
  if (desk.site.traffic.state === "running") desk.kept.polling = setTimeout(() => poll(desk), POLL_MS);
  else if (desk.site.traffic.state === "done") {
    // The camera was fitted to the boxes of the search before.
    if (before === "running" && desk.store.drawing.use_traffic) {
      desk.isStale = true;
      desk.measure();
    }
    count(desk);
  }
  desk.render();
}

/** @param {Desk} desk */
async function count(desk) {
  const { drawing } = desk.store;
  desk.kept.countProblem = "";
  try {
    const counts = inFolder(desk, await server.count(drawing));
    desk.kept.counts = counts;
    const [first] = counts.frames;
    if (first && desk.frame === null && desk.at === 3) desk.show(desk.site.frames.indexOf(first.frame));
  } catch (error) {
    desk.kept.counts = null;
    desk.kept.countProblem = /** @type {Error} */ (error).message;
  }
  desk.render();
}

/** The counts of the pictures that the folder has: the search may have seen others. @param {Desk} desk @param {Counts} counts */
function inFolder(desk, counts) {
  const names = new Set(desk.site.frames);
  const frames = counts.frames.filter((f) => names.has(f.frame));
  desk.kept.leftOut = counts.frames.length - frames.length;
  if (!desk.kept.leftOut) return counts;
  const vehicles = (/** @type {number} */ lane) => frames.reduce((sum, f) => sum + f.boxes.filter((b) => b.lane === lane).length, 0);
  const lanes = counts.lanes.map((lane) => ({ ...lane, vehicles: vehicles(lane.lane) / Math.max(1, frames.length) }));
  return { frames, lanes };
}

/** Begins the search, or begins it anew. @param {Desk} desk */
async function begin(desk) {
  const { kept } = desk;
  kept.countProblem = "";
  if (kept.playing) play(desk);
  try {
    desk.site.traffic = await server.search();
    kept.counts = null;
    await poll(desk);
  } catch (error) {
    kept.countProblem = /** @type {Error} */ (error).message;
    desk.render();
  }
}

/** @param {Desk} desk */
function play(desk) {
  clearInterval(desk.kept.playing);
  desk.kept.playing = desk.kept.playing ? 0 : setInterval(() => {
    if (desk.at !== 3) play(desk);
    else desk.show((desk.frame ?? -1) + 1);
  }, 1000 / PER_S);
  desk.render();
}

/** The boxes of the picture that is shown. @param {Desk} desk */
function shown(desk) {
  /** @type {Counts | null} */
  const counts = desk.kept.counts ?? null;
  const name = desk.frame === null ? "" : desk.site.frames[desk.frame];
  return counts?.frames.find((f) => f.frame === name)?.boxes ?? [];
}

/** @type {Step} */
export const step = {
  name: "Traffic",
  movable: [],
  tools: () => [],
  hint: () => "",
  done: (desk) => !!desk.kept.counts,
  enter(desk) {
    poll(desk);
  },
  key(desk, key) {
    if (key === "p") play(desk);
    return key === "p";
  },
  paint(desk, c, placed) {
    paintLanes(desk, c, placed, false);
    for (const box of shown(desk)) vehicleBox(c, placed, box, desk.kept.shift ?? [0, 0]);
  },
  panel(desk) {
    const { traffic } = desk.site;
    return [
      el("h2", { text: "The traffic" }),
      ...(traffic.state === "done" ? counted(desk) : search(desk)),
      el("div", { class: "actions" }, el("button", { class: "primary", id: "next", onclick: () => desk.go(4) }, "Save the site")),
    ];
  },
};

/** @param {Desk} desk */
function search(desk) {
  const { traffic } = desk.site;
  const problem = desk.kept.countProblem || traffic.problem;
  if (!traffic.detector)
    return [el("div", { class: "card", id: "no-detector" }, "There is no detector here. Start the desk where the program ", el("code", { text: "verge" }), " and a model are (", el("code", { text: "--verge" }), ", ", el("code", { text: "--model" }), "), or go on: it is not needed to save the site.")];
  if (traffic.state === "running")
    return [
      el("div", { class: "card" }, `Searching pictures for vehicles: ${traffic.searched} of ${desk.site.frames.length} … ${traffic.running_s.toFixed(0)} s`),
      desk.kept.countProblem && el("div", { class: "card bad", text: desk.kept.countProblem }),
    ];
  return [
    problem && el("div", { class: "card bad", text: problem }),
    el("p", { class: "dim", text: "Find the vehicles of the pictures, and see which lane each is counted in." }),
    el("button", { class: "primary", id: "search", onclick: () => begin(desk) }, `Find vehicles in ${many(desk.site.frames.length, "picture")}`),
  ];
}

/** @param {Desk} desk */
function counted(desk) {
  /** @type {Counts | null} */
  const counts = desk.kept.counts ?? null;
  const { traffic } = desk.site;
  const { countProblem, leftOut } = desk.kept;
  const again = traffic.detector
    && el("button", { id: "again", title: "Searches all pictures of the folder anew", onclick: () => begin(desk) }, "Find again");
  // Boxes there are: what the program says besides is of pictures that it left out.
  const said = countProblem || traffic.problem;
  const problem = said && el("div", { class: `card ${countProblem ? "bad" : "fair"}`, id: "count-problem", text: said });
  if (!counts) return [problem || el("div", { class: "card", text: "Counting …" }), el("div", { class: "actions" }, again)];
  const now = shown(desk);
  const rows = counts.lanes.map((lane) => {
    const swatch = el("span", { text: `● ` });
    swatch.style.color = laneColour(lane.lane);
    return el("tr", {},
      el("td", {}, swatch, `lane ${lane.lane}`),
      el("td", { text: String(now.filter((b) => b.lane === lane.lane).length) }),
      el("td", { text: lane.vehicles.toFixed(2) }),
      el("td", { text: ((1000 * lane.vehicles) / lane.length_m).toFixed(1) }));
  });
  return [
    el("div", { class: "actions" },
      el("button", { id: "play", onclick: () => play(desk) }, desk.kept.playing ? "Stop" : "Play"),
      el("button", { onclick: () => desk.show((desk.frame ?? 0) - 1) }, "‹"),
      el("button", { onclick: () => desk.show((desk.frame ?? -1) + 1) }, "›"),
      again),
    problem,
    leftOut > 0 && el("div", { class: "card fair", id: "frames-left-out", text: `${many(leftOut, "picture")} of the search ${leftOut === 1 ? "is" : "are"} not in this folder and left out.` }),
    el("table", { id: "counts" },
      el("tr", {}, el("th", { text: "" }), el("th", { text: "now" }), el("th", { text: "mean" }), el("th", { text: "veh/km" })),
      ...rows),
    el("p", { class: "dim", text: `${many(counts.frames.length, "picture")}. Dashed boxes are not counted: they stand beside the lanes, are cut off, or are unsure.` }),
  ];
}
