// Pictures from a camera: how long, how often, and how far it is.

import { byId, el, fill, many } from "./elements.js";
import * as server from "./server.js";

/** @typedef {import("./types.js").CollectionState} CollectionState */

const POLL_MS = 700;
/** Fewest pictures of which vehicles go away. */
const FEW = 7;
/** @type {[number, string][]} */
const LENGTHS = [[60, "1 minute"], [300, "5 minutes"], [1800, "30 minutes"], [7200, "2 hours"], [43200, "12 hours"]];
/** @type {[number, string][]} */
const INTERVALS = [[1, "1 s"], [2, "2 s"], [5, "5 s"], [10, "10 s"], [30, "30 s"], [60, "1 minute"]];

/** @param {number} s */
const clock = (s) => {
  const [h, m] = [Math.floor(s / 3600), Math.floor((s % 3600) / 60)];
  const tail = `${String(m).padStart(h ? 2 : 1, "0")}:${String(Math.floor(s % 60)).padStart(2, "0")}`;
  return h ? `${h}:${tail}` : tail;
};

/**
 * A choice of seconds.
 * @param {string} id @param {string} text @param {[number, string][]} all @param {number} now
 */
function choice(id, text, all, now) {
  const select = el("select", { id, data: { key: id } }, ...all.map(([s, name]) => el("option", { value: String(s), selected: s === now }, name)));
  return { row: el("label", { class: "row" }, el("span", { text }), select), select };
}

/**
 * Shows the camera until there are pictures to go on with.
 * @param {CollectionState} first
 * @returns {Promise<void>}
 */
export function collect(first) {
  const live = /** @type {HTMLImageElement} */ (byId("live"));
  byId("busy").textContent = "The camera's latest picture will be here";
  byId("canvas").hidden = true;
  return new Promise((resolve) => {
    let state = first;
    let problem = "";
    // An answer that comes after the end must not draw over the next step.
    let over = false;
    const done = async () => {
      if (over) return;
      over = true;
      try {
        await server.useCollected();
      } catch (error) {
        over = false;
        problem = /** @type {Error} */ (error).message;
        return render();
      }
      live.hidden = true;
      byId("canvas").hidden = false;
      byId("busy").textContent = "Reading the pictures …";
      byId("busy").hidden = false;
      resolve();
    };
    /** @param {() => Promise<CollectionState>} ask */
    const ask = async (ask) => {
      try {
        state = await ask();
        problem = "";
      } catch (error) {
        problem = /** @type {Error} */ (error).message;
      }
      render();
    };
    const poll = async () => {
      const was = state.state;
      await ask(server.collection);
      if (over) return;
      if (state.state === "running") setTimeout(poll, POLL_MS);
      else if (was === "running" && state.state === "done") done();
    };
    /** @param {number} interval_s @param {number} for_s */
    const start = async (interval_s, for_s) => {
      await ask(() => server.collect(interval_s, for_s));
      if (state.state === "running") setTimeout(poll, POLL_MS);
    };
    const stop = async () => {
      await ask(server.stopCollecting);
      done();
    };
    const use = () => el("button", { id: "use", onclick: done }, `Go on with ${many(state.pictures, "picture that is there", "pictures that are there")}`);

    const idle = () => {
      const length = choice("for", "For how long", LENGTHS, state.for_s);
      const interval = choice("interval", "A picture every", INTERVALS, state.interval_s);
      return [
        (state.problem || problem) && el("div", { class: "card bad", id: "collect-problem", text: state.problem || problem }),
        length.row,
        interval.row,
        el("p", { class: "dim", text: "Five minutes are enough to draw on. With an hour or more the traffic itself helps to measure the road, and the audit can choose from light and heavy traffic." }),
        el("div", { class: "actions" },
          el("button", { class: "primary", id: "collect", onclick: () => start(Number(interval.select.value), Number(length.select.value)) }, "Collect pictures"),
          state.pictures > 0 && use()),
      ];
    };
    const running = () => {
      const bar = el("i");
      bar.style.width = `${Math.min(100, (100 * state.running_s) / state.for_s)}%`;
      const n = state.collected;
      return [
        el("div", { class: "card" },
          el("div", { class: "big", id: "collected", text: many(n, "picture") }),
          el("div", { class: "dim", text: `${clock(state.running_s)} of ${clock(state.for_s)}, one every ${state.interval_s} s` }),
          el("div", { class: "progress" }, bar)),
        (state.problem || problem) && el("div", { class: "card fair", text: state.problem || problem }),
        n > 0 && n < FEW && el("p", { class: "dim", text: `With fewer than ${FEW} pictures vehicles stay in the picture without traffic.` }),
        el("div", { class: "actions" }, el("button", { class: n >= FEW ? "primary" : "", id: "enough", disabled: n === 0, onclick: stop }, `Enough: go on with ${state.pictures}`)),
        el("p", { class: "dim", text: "This page may be closed meanwhile: the pictures go on into the folder." }),
      ];
    };
    const render = () => {
      if (over) return;
      if (state.latest && live.dataset.name !== state.latest) {
        live.dataset.name = state.latest;
        live.src = server.pictureAddress(state.latest);
        live.hidden = false;
        byId("busy").hidden = true;
      }
      byId("hint").textContent = live.hidden ? "" : "Is the road in view? What the camera shows now is the latest picture.";
      fill(byId("panel"),
        el("h2", { text: "Pictures from the camera" }),
        el("p", {}, el("code", { text: state.camera ?? "" })),
        ...(state.state === "running" ? running() : idle()));
    };
    render();
    if (state.state === "running") poll();
  });
}
