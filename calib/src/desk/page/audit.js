// Step 6: pictures that a person counts, before any box is shown, and what follows.

import { el, many } from "./elements.js";
import { paintLanes } from "./lanes.js";
import { laneColour } from "./paint.js";
import * as server from "./server.js";

/** @typedef {import("./types.js").AuditState} AuditState */
/** @typedef {import("./main.js").Desk} Desk */
/** @typedef {import("./main.js").Step} Step */
/**
 * What was counted so far.
 * @typedef {Object} Sheet
 * @property {string[]} frames
 * @property {number[]} lanes
 * @property {string[][]} typed what was typed, by picture and lane
 * @property {boolean[]} skipped pictures that cannot be counted
 * @property {number} at the picture that is counted now
 * @property {string} focus the field that is typed in next
 */

const POLL_MS = 700;
/** Fewest pictures from which anything follows, as `verge audit` has it. */
const LEAST = 3;
/** More vehicles than any lane holds in one picture. */
const MOST = 200;

/** @param {Desk} desk @returns {AuditState | null} */
const state = (desk) => desk.kept.audit ?? null;
/** @param {Desk} desk @returns {Sheet | null} */
const sheet = (desk) => desk.kept.sheet ?? null;

/** @param {Desk} desk @param {() => Promise<AuditState>} ask */
async function ask(desk, ask) {
  try {
    desk.kept.audit = await ask();
    desk.kept.auditProblem = "";
  } catch (error) {
    desk.kept.auditProblem = /** @type {Error} */ (error).message;
  }
  const now = state(desk);
  if (now && now.frames.length && !fits(sheet(desk), now)) begin(desk, now);
  if (now && [now.choosing, now.comparing].includes("running")) setTimeout(() => ask_again(desk), POLL_MS);
  else if (now?.problem) showContradiction(desk, now.problem);
  desk.render();
  focus(desk);
}

/** @param {Desk} desk */
const ask_again = (desk) => ask(desk, server.audit);

/** Whether a sheet is of these pictures and lanes. @param {Sheet | null} sheet @param {AuditState} now */
const fits = (sheet, { frames, lanes }) => !!sheet && sheet.frames.join() === frames.join() && sheet.lanes.join() === lanes.join();

/** @param {Desk} desk @param {AuditState} now */
function begin(desk, now) {
  const { frames, lanes } = now;
  desk.kept.sheet = { frames, lanes, typed: frames.map(() => lanes.map(() => "")), skipped: frames.map(() => false), at: 0, focus: "" };
  go(desk, 0);
}

/** @param {Desk} desk @param {number} at */
function go(desk, at) {
  const now = sheet(desk);
  if (!now) return;
  now.at = Math.min(Math.max(at, 0), now.frames.length - 1);
  now.focus = key(now, 0);
  const place = desk.site.frames.indexOf(now.frames[now.at]);
  if (place >= 0) desk.show(place);
  desk.render();
  focus(desk);
}

/** Puts the cursor into the field that is next. @param {Desk} desk */
function focus(desk) {
  const now = sheet(desk);
  if (!now?.focus || desk.step !== step) return;
  const field = /** @type {HTMLInputElement | null} */ (document.querySelector(`#panel [data-key="${now.focus}"]`));
  now.focus = "";
  field?.focus({ preventScroll: true });
  field?.select();
}

/** A picture whose answer contradicts the others is shown again. @param {Desk} desk @param {string} problem */
function showContradiction(desk, problem) {
  const now = sheet(desk);
  const at = now?.frames.findIndex((frame) => problem.includes(frame)) ?? -1;
  if (at >= 0 && desk.kept.contradiction !== problem) {
    desk.kept.contradiction = problem;
    go(desk, at);
  }
}

/** @param {Sheet} now @param {number} l */
const key = (now, l) => `count-${now.at}-${l}`;
/** @param {string} text */
const isCount = (text) => /^\d+$/.test(text.trim()) && Number(text) <= MOST;
/** @param {Sheet} now @param {number} k */
const isCounted = (now, k) => !now.skipped[k] && now.typed[k].every(isCount);
/** @param {Sheet} now @param {number} k */
const isAnswered = (now, k) => now.skipped[k] || isCounted(now, k);
/** Begun, and not counted to its end: it can neither be sent nor left out. @param {Sheet} now @param {number} k */
const isPartial = (now, k) => !isAnswered(now, k) && now.typed[k].some((text) => text.trim());

/** @param {Desk} desk */
function compare(desk) {
  const now = sheet(desk);
  const lanes = state(desk)?.lanes ?? [];
  if (!now) return;
  desk.kept.contradiction = "";
  const answers = now.frames
    .map((frame, k) => ({ frame, counts: lanes.map((lane, l) => [lane, Number(now.typed[k][l])]), k }))
    .filter(({ k }) => isCounted(now, k))
    .map(({ frame, counts }) => ({ frame, counts }));
  ask(desk, () => server.compareAudit(answers));
}

/** @type {Step} */
export const step = {
  name: "Audit",
  movable: [],
  tools: () => [],
  hint: (desk) => (sheet(desk) && !state(desk)?.result ? "Count the vehicles in each lane. What the sensor counts is shown when you have answered." : ""),
  done: (desk) => !!state(desk)?.result || !!state(desk)?.audited,
  enter(desk) {
    ask_again(desk);
    const now = sheet(desk);
    if (now) go(desk, now.at);
  },
  paint: (desk, c, placed) => paintLanes(desk, c, placed, false),
  panel(desk) {
    const now = state(desk);
    return [el("h2", { text: "The audit" }), ...(now ? body(desk, now) : [el("p", { class: "dim", text: desk.kept.auditProblem || "…" })])];
  },
};

/** @param {Desk} desk @param {AuditState} now @returns {(Node | string | null | undefined | false)[]} */
function body(desk, now) {
  const explained = el("p", { class: "dim", text: "You count ten pictures by eye; the sensor counts them too. What it finds too few or too many is corrected from then on, and the error of every density is stated by it." });
  if (!now.detector)
    return [explained, el("div", { class: "card", id: "no-detector" }, "There is no detector here. Start the desk where the program ", el("code", { text: "verge" }), " and a model are (", el("code", { text: "--verge" }), ", ", el("code", { text: "--model" }), ").")];
  if (!now.lanes.length || desk.store.changed)
    return [explained,
      el("div", { class: "card fair", id: "save-first", text: now.lanes.length ? "Something was changed since the site was saved. The saved lanes are counted: save first." : "The saved lanes are counted: save the site first." }),
      el("div", { class: "actions" }, el("button", { class: "primary", onclick: () => desk.go(4) }, "Save the site"))];
  const problem = desk.kept.auditProblem || now.problem;
  const wrong = problem && el("div", { class: "card bad", id: "audit-problem", text: problem });
  if (now.choosing === "running") return [explained, el("div", { class: "card" }, `Looking through ${many(desk.site.frames.length, "picture")} for ten of light and heavy traffic … ${now.running_s.toFixed(0)} s`)];
  const counting = sheet(desk);
  if (!counting)
    return [explained, wrong,
      now.audited && el("div", { class: "card good", text: "This site has an audit. A new one takes its place." }),
      el("div", { class: "actions" }, el("button", { class: "primary", id: "choose", onclick: () => ask(desk, server.chooseAudit) }, "Choose ten pictures"))];
  if (now.comparing === "running") return [el("div", { class: "card" }, `The sensor counts … ${now.running_s.toFixed(0)} s`)];
  return [...(now.result && !problem ? outcome(now, counting) : []), wrong, ...form(desk, now, counting)];
}

/** @param {Desk} desk @param {AuditState} state @param {Sheet} now */
function form(desk, state, now) {
  const all = now.frames.length;
  const answered = now.frames.filter((_, k) => isAnswered(now, k)).length;
  const counted = now.frames.filter((_, k) => isCounted(now, k)).length;
  const partial = now.frames.flatMap((_, k) => (isPartial(now, k) ? k + 1 : []));
  const ready = partial.length === 0 && counted >= LEAST;
  const contradicted = desk.kept.contradiction ?? "";
  const shown = desk.frame !== null && desk.site.frames[desk.frame] === now.frames[now.at];
  return [
    el("h3", { text: `Picture ${now.at + 1} of ${now.frames.length}` }),
    el("div", { class: "dots" }, ...now.frames.map((frame, k) =>
      el("button", {
        class: `dot ${contradicted.includes(frame) || (k !== now.at && isPartial(now, k)) ? "bad" : now.skipped[k] ? "out" : isCounted(now, k) ? "done" : ""}`,
        "aria-current": k === now.at && "true", title: frame, onclick: () => go(desk, k),
      }, String(k + 1)))),
    !shown && el("div", { class: "actions" }, el("button", { onclick: () => go(desk, now.at) }, "Show the picture that is counted")),
    ...state.lanes.flatMap((lane, l) => field(desk, now, lane, l)),
    el("p", { class: "dim", text: "A vehicle stands in the lane where the middle of its lower edge is. Motorcycles count, bicycles do not; a third of a vehicle must be seen." }),
    el("div", { class: "actions" },
      el("button", { class: ready && answered === all ? "primary" : "", id: "compare", disabled: !ready, onclick: () => compare(desk) },
        !ready ? `${answered} of ${all} counted` : answered === all ? "Compare with the sensor" : `Compare with ${counted} of ${all}`),
      el("button", { id: "skip", "aria-pressed": String(now.skipped[now.at]), onclick: () => skip(desk, now) }, "Cannot be counted")),
    el("p", { class: "dim" }, el("kbd", { text: "Enter" }), " goes to the next lane and the next picture."),
    partial.length > 0 && el("p", { class: partial.some((k) => k !== now.at + 1) ? "bad-text" : "dim", id: "partial", text: `Count every lane of picture ${partial.join(", ")}, or say that it cannot be counted.` }),
    ready && answered < all && el("p", { class: "dim", text: "A picture whose counts are empty is left out. More pictures make the audit surer." }),
    answered === all && counted < LEAST && el("p", { class: "bad-text", text: `${LEAST} pictures are the fewest from which anything follows.` }),
  ];
}

/** @param {Desk} desk @param {Sheet} now */
function skip(desk, now) {
  now.skipped[now.at] = !now.skipped[now.at];
  if (now.skipped[now.at]) go(desk, now.at + 1);
  else desk.render();
}

/** @param {Desk} desk @param {Sheet} now @param {number} lane @param {number} l */
function field(desk, now, lane, l) {
  // Each picture has fields of its own: what is typed for one must not show in the next.
  const name = key(now, l);
  const typed = now.typed[now.at][l];
  const wrong = typed.trim() !== "" && !isCount(typed);
  const swatch = el("span", { class: "swatch", text: String(lane) });
  swatch.style.background = laneColour(lane);
  const input = el("input", {
    class: "metres", type: "text", inputmode: "numeric", data: { key: name }, id: `count-${l}`, disabled: now.skipped[now.at],
    value: typed, "aria-label": `vehicles in lane ${lane}`, "aria-invalid": wrong && "true", autocomplete: "off",
    oninput: () => {
      now.typed[now.at][l] = input.value;
      desk.render();
    },
    onkeydown: (/** @type {KeyboardEvent} */ event) => {
      if (event.key !== "Enter") return;
      event.preventDefault();
      event.stopPropagation();
      if (!isCount(now.typed[now.at][l])) return;
      if (l + 1 < now.typed[now.at].length) {
        now.focus = key(now, l + 1);
        focus(desk);
      } else {
        const open = now.frames.findIndex((_, k) => k > now.at && !isAnswered(now, k));
        const any = open >= 0 ? open : now.frames.findIndex((_, k) => !isAnswered(now, k));
        if (any >= 0) go(desk, any);
        else {
          desk.render();
          document.getElementById("compare")?.focus();
        }
      }
    },
  });
  return [
    el("label", { class: "row count" }, swatch, el("span", { text: `Vehicles in lane ${lane}` }), input),
    wrong && el("span", { class: "bad-text", role: "alert", text: `a whole number from 0 to ${MOST}` }),
  ];
}

/** @param {AuditState} now @param {Sheet} counting */
function outcome(now, counting) {
  const result = /** @type {NonNullable<AuditState["result"]>} */ (now.result);
  const { correction, frames } = result;
  const [stated, found] = [result.stated_score, correction.score ?? result.stated_score].map((x) => x.toFixed(2));
  const said = correction.by_load.map(({ counted, factor, factor_se }) => {
    const off = 1.645 * factor_se;
    return el("tr", {},
      el("td", { text: counted.toFixed(1) }),
      el("td", { text: `× ${factor.toFixed(2)}` }),
      el("td", { class: "dim", text: `${(factor - off).toFixed(2)} to ${(factor + off).toFixed(2)}` }));
  });
  return [
    el("div", { class: "card good", id: "audited" },
      el("b", { text: `Audited with ${many(frames.length, "picture")} and ${many(result.vehicles, "vehicle")}. ` }),
      found === stated ? `Boxes count from a score of ${stated}, as the model has it.` : `Boxes count from a score of ${found} here, in place of ${stated}.`,
      el("div", { class: "dim" }, "Saved as ", el("code", { text: "audit.toml" }), ", named in ", el("code", { text: "verge.toml" }), ".")),
    said.length
      ? el("table", { id: "loads" }, el("tr", {}, el("th", { text: "vehicles counted" }), el("th", { text: "are" }), el("th", { text: "with 90 % in" })), ...said)
      : el("p", { class: "dim", text: "So few vehicles stand in these pictures that counts are not corrected." }),
    el("h3", { text: "Picture by picture" }),
    el("table", { id: "audit-frames" },
      el("tr", {}, el("th", { text: "picture" }), el("th", { text: "you" }), el("th", { text: "sensor" })),
      ...frames.map((frame) => el("tr", {}, el("td", { title: frame.frame, text: String(counting.frames.indexOf(frame.frame) + 1) }), el("td", { text: String(frame.people) }), el("td", { class: frame.people === frame.line ? "" : "fair-text", text: String(frame.line) })))),
  ];
}
