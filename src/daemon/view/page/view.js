// The sensor's view now: the picture, its lanes and vehicles, counts, and health.

import { byId, el, fill } from "./elements.js";
import { laneColour, vehicleBox } from "./paint.js";
import { Stage, toScreen } from "./stage.js";

/** @typedef {import("./stage.js").Placed} Placed */
/**
 * @typedef {Object} Seen
 * @property {[number, number]} size
 * @property {{corners: [number, number, number, number], score: number, class: string, lane: number | null, s_m: number | null}[]} boxes
 * @property {{lane: number, direction: string, length_m: number, vehicles: number, mean: number}[]} lanes
 * @property {string} aim
 * @property {[number, number]} shift_px
 * @property {string | null} light
 * @property {number | null} road_age_s
 */
/**
 * @typedef {Object} Answer
 * @property {string} site
 * @property {string} camera
 * @property {string} source
 * @property {number} interval_s
 * @property {number} number
 * @property {string} time
 * @property {Seen | null} seen
 * @property {string | null} problem
 * @property {number} measured
 * @property {number} failed
 * @property {number} took_ms
 */

const POLL_MS = 500;
/** Every so many rows of the lanes are sent. */
const ROWS = 2;
/** @type {Record<string, string>} */
const AIMS = {
  in_place: "stands where the lanes were drawn",
  unverified: "is not yet recognised",
  moved: "has moved: the lanes do not fit",
  unchecked: "is not checked",
  "not checked": "is not checked",
};

/** @type {Answer | null} */
let now = null;
/**
 * Runs: lane, row, first and last column, and the distances of these two from the lane's upstream end,
 * dm. Sections, where vehicles are counted: lane, column, row.
 * @type {{runs: [number, number, number, number, number, number][], sections: [number, number, number][]}}
 */
let lanes = { runs: [], sections: [] };
const shown = { lanes: true, boxes: true };
let shift = "";
let failure = "";

const nothing = () => {};
const stage = new Stage(/** @type {HTMLCanvasElement} */ (byId("canvas")), { down: nothing, move: pointed, up: nothing, finish: nothing });
stage.painters.push(paint);

/** @param {CanvasRenderingContext2D} c @param {Placed} placed */
function paint(c, placed) {
  if (shown.lanes) {
    for (const [lane, v, from, to] of lanes.runs) {
      const [x0, y0] = toScreen(placed, [from, v]);
      const [x1, y1] = toScreen(placed, [to + 1, v + ROWS]);
      const colour = laneColour(lane);
      c.fillStyle = `${colour}38`;
      c.fillRect(x0, y0, x1 - x0, y1 - y0);
      c.fillStyle = colour;
      c.fillRect(x0, y0, 1.5, y1 - y0);
      c.fillRect(x1 - 1.5, y0, 1.5, y1 - y0);
    }
    c.fillStyle = "#ffffff";
    for (const [, u, v] of lanes.sections) {
      const [x, y] = toScreen(placed, [u, v]);
      c.fillRect(x, y, Math.max(placed.scale, 2), Math.max(placed.scale, 2));
    }
  }
  if (shown.boxes && now?.seen && !now.problem) for (const box of now.seen.boxes) vehicleBox(c, placed, box, [0, 0]);
}

/** Which place of a lane the pointer is at, in words. */
let place = "";
const POINT = "point at a lane to see how far it is from its upstream end";

/** @param {[number, number]} at */
function pointed([u, v]) {
  const run = lanes.runs.find(([, row, from, to]) => v >= row && v < row + ROWS && u >= from && u < to + 1);
  place = "";
  if (run) {
    const [lane, , from, to, fromDm, toDm] = run;
    const share = to > from ? Math.min(Math.max((u - 0.5 - from) / (to - from), 0), 1) : 0;
    place = `lane ${lane}, ${((fromDm + share * (toDm - fromDm)) / 10).toFixed(1)} m from its upstream end`;
  }
  const shown = document.getElementById("place");
  if (shown) shown.textContent = place || POINT;
}

async function poll() {
  try {
    const response = await fetch("api/seen");
    if (!response.ok) throw new Error((await response.text()).trim());
    const was = now?.number ?? 0;
    /** @type {Answer} */
    const answer = await response.json();
    if (answer.number !== was) await take(answer);
    now = answer;
    failure = "";
  } catch (error) {
    failure = `the view does not answer: ${/** @type {Error} */ (error).message}`;
  }
  render();
  setTimeout(poll, POLL_MS);
}

/** Fetches the picture of an answer. @param {Answer} answer */
async function take(answer) {
  const image = new Image();
  image.src = `api/picture.jpg?${answer.number}`;
  await image.decode();
  const size = /** @type {[number, number]} */ ([image.naturalWidth, image.naturalHeight]);
  const place = `${answer.seen?.shift_px.map(Math.round)} ${size}`;
  if (place !== shift) {
    lanes = await (await fetch("api/lanes")).json();
    shift = place;
  }
  const first = stage.image === null || stage.size[0] !== size[0];
  stage.size = size;
  stage.show(image, [0, 0]);
  if (first) stage.fit();
  byId("busy").hidden = true;
}

/** @param {string} id @param {string} text @param {"lanes" | "boxes"} what */
const toggle = (id, text, what) =>
  el("button", { class: "small", id, "aria-pressed": String(shown[what]), onclick: () => { shown[what] = !shown[what]; render(); } }, text);

function render() {
  fill(byId("backdrops"), toggle("lanes", "Lanes", "lanes"), toggle("boxes", "Vehicles", "boxes"),
    el("button", { class: "small", onclick: () => stage.fit() }, "Fit"));
  const problem = failure || now?.problem || "";
  byId("name").textContent = now ? `${now.site} · ${now.camera}` : "";
  const verdict = byId("verdict");
  verdict.textContent = problem ? "not measured" : now?.seen ? "measuring" : "";
  verdict.className = `verdict ${problem ? "bad" : "good"}`;
  if (!now?.number) byId("busy").textContent = problem || "Asking the camera …";
  fill(byId("panel"), ...(now ? panel(now, problem) : [problem && el("div", { class: "card bad", text: problem })]));
  stage.paint();
}

/** @param {Answer} answer @param {string} problem */
function panel(answer, problem) {
  const { seen } = answer;
  return [
    problem && el("div", { class: "card bad", id: "problem", text: problem }),
    el("h2", { text: "The traffic now" }),
    seen && el("table", { id: "counts" },
      el("tr", {}, el("th", { text: "" }), el("th", { text: "now" }), el("th", { text: "mean" }), el("th", { text: "veh/km" })),
      ...seen.lanes.map((lane) => {
        const swatch = el("span", { text: "● " });
        swatch.style.color = laneColour(lane.lane);
        return el("tr", {},
          el("td", {}, swatch, `lane ${lane.lane} ${lane.direction}`),
          el("td", { text: String(lane.vehicles) }),
          el("td", { text: lane.mean.toFixed(2) }),
          el("td", { text: ((1000 * lane.mean) / lane.length_m).toFixed(1) }));
      })),
    seen && el("p", { class: "dim", text: `${seen.boxes.filter((b) => b.lane === null).length} more vehicles beside the lanes, dashed. Means are of ${answer.measured === 1 ? "one picture" : `${answer.measured} pictures`} since this view was opened; the published windows are the sensor's own.` }),
    el("p", { class: "dim", id: "place", text: place || POINT }),
    lanes.sections.length > 0 && el("p", { class: "dim", text: "White lines: the sections where vehicles are counted (traffic.section_m)." }),
    el("h3", { text: "Health" }),
    el("table", { id: "health" },
      row("picture", answer.time || "none yet"),
      row("pictures", `${answer.measured} measured, ${answer.failed} not`),
      row("measured in", `${answer.took_ms} ms, one each ${answer.interval_s} s`),
      seen && row("camera", AIMS[seen.aim] ?? seen.aim),
      seen && row("scene off its place", `${seen.shift_px.map((px) => px.toFixed(1)).join(", ")} px`),
      seen?.light && row("light", seen.light),
      seen && seen.road_age_s !== null && row("empty road learned", `${seen.road_age_s} s ago`)),
    el("h3", { text: "This view" }),
    el("p", { class: "dim" }, "asks ", el("code", { text: answer.source }), " by itself, beside the sensor, and only while this page is open. It changes nothing and publishes nothing."),
  ];
}

/** @param {string} name @param {string} value */
const row = (name, value) => el("tr", {}, el("td", { class: "dim", text: name }), el("td", { text: value }));

window.addEventListener("keydown", (event) => {
  if (event.key === "0") stage.fit();
  else if (event.key === "+" || event.key === "=") stage.zoom(1.25);
  else if (event.key === "-") stage.zoom(0.8);
  else if (event.key === "l" || event.key === "b") {
    const what = event.key === "l" ? "lanes" : "boxes";
    shown[what] = !shown[what];
    render();
  }
});

poll();
