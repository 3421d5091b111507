// The desk: its steps, its keys, and what is shown when.

import * as audit from "./audit.js";
import { collect } from "./collect.js";
import { byId, el, fill, percent } from "./elements.js";
import { carry, wrongFields } from "./fields.js";
import * as keys from "./keys.js";
import * as lanes from "./lanes.js";
import { ERRORS } from "./paint.js";
import * as pictures from "./pictures.js";
import * as road from "./road.js";
import * as save from "./save.js";
import * as server from "./server.js";
import { Stage } from "./stage.js";
import { isBlank, Store } from "./store.js";
import { Hand, lists, remove } from "./tools.js";
import * as traffic from "./traffic.js";

/** @typedef {import("./types.js").Px} Px */
/** @typedef {import("./types.js").Handle} Handle */
/** @typedef {import("./types.js").Selection} Selection */

/**
 * What a click does.
 * @typedef {Object} Tool
 * @property {string} name
 * @property {string} key
 * @property {string} colour
 * @property {"" | Handle["kind"]} takes the points that it takes in place of a click
 * @property {string} hint
 * @property {boolean} [closes]
 * @property {boolean} [begins] whether a click on a point that it takes begins something new there
 * @property {(at: Px, hand: Hand, event: PointerEvent) => void} click
 * @property {(hand: Hand) => void} [finish]
 */

/**
 * One step of the way.
 * @typedef {Object} Step
 * @property {string} name
 * @property {(desk: Desk) => Tool[]} tools
 * @property {Handle["kind"][]} movable
 * @property {(desk: Desk) => (Node | string | null | undefined | false)[]} panel
 * @property {(desk: Desk, c: CanvasRenderingContext2D, placed: import("./stage.js").Placed) => void} paint
 * @property {(desk: Desk) => string} hint
 * @property {(desk: Desk) => boolean} done
 * @property {(desk: Desk) => void} [enter]
 * @property {(desk: Desk, key: string) => boolean} [key]
 */

/** @type {Step[]} */
const STEPS = [pictures.step, road.step, lanes.step, traffic.step, save.step, audit.step];
/** Time after a change until it is measured, ms. */
const SOON_MS = 40;

export class Desk {
  /** @param {import("./types.js").Site} site */
  constructor(site) {
    this.site = site;
    this.store = new Store(site.drawing, site.saved);
    /** The drawing of the server that this one goes on from. */
    this.version = site.version;
    /** @type {import("./types.js").Look | null} */
    this.look = null;
    this.hand = new Hand(this);
    this.stage = new Stage(/** @type {HTMLCanvasElement} */ (byId("canvas")), this.hand);
    this.stage.size = site.image_size;
    this.stage.painters.push((c, placed) => {
      this.step.paint(this, c, placed);
      this.hand.paint(c, placed);
    });
    this.at = 0;
    /** @type {Tool[]} */
    this.tools = [];
    /** @type {Tool | null} */
    this.tool = null;
    /** @type {Selection} */
    this.selection = null;
    /** The frame that is shown; `null` for the picture without traffic. @type {number | null} */
    this.frame = null;
    this.shownOld = false;
    this.magnifier = true;
    this.isLooking = false;
    this.isStale = true;
    this.failure = "";
    /** What was just done or refused, until the next click or key. */
    this.notice = "";
    /** Fields whose text is no number, by whose text it is. @type {Map<unknown, import("./fields.js").Wrong>} */
    this.wrong = new Map();
    /** What single steps keep. @type {Record<string, any>} */
    this.kept = {};
    this.store.onChange((before) => this.changed(before));
    this.listen();
  }

  /** How the camera moved since the site was saved, until somebody has looked. */
  get moved() {
    return this.store.drawing.backdrop === this.site.backdrop ? null : this.site.moved;
  }

  get step() {
    return STEPS[this.at];
  }

  movable() {
    return new Set(this.step.movable);
  }

  /** @param {number} at */
  go(at) {
    this.leave();
    this.at = Math.min(Math.max(at, 0), STEPS.length - 1);
    this.selection = null;
    this.tools = this.step.tools(this);
    this.tool = this.tools[0] ?? null;
    this.step.enter?.(this);
    this.render();
  }

  /** @param {Tool | null} tool */
  take(tool) {
    this.leave();
    this.tool = tool;
    this.render();
  }

  /** What is half drawn is finished where it can be; what cannot is said to be gone. */
  leave() {
    const { hand, tool } = this;
    hand.withdraw();
    if (!hand.pending.length || !tool) return;
    tool.finish?.(hand);
    const what = `what was half drawn (${tool.name})`;
    this.say(hand.pending.length ? `Dropped ${what}: it had too few points.` : `Finished ${what}. Ctrl+Z takes it back.`);
    hand.cancel();
  }

  /** @param {string} notice */
  say(notice) {
    this.notice = notice;
    this.renderHint();
  }

  unsay() {
    if (this.notice) this.say("");
  }

  undo() {
    const { hand } = this;
    if (hand.isOffered || !hand.pending.length) this.store.undo();
    else hand.pending.pop();
    this.stage.paint();
  }

  /** @param {Selection} selection */
  select(selection) {
    this.hand.withdraw();
    this.selection = selection;
    this.render();
  }

  /** What lies under the mouse, where nothing is drawn. @param {Px} at @returns {Selection} */
  under(at) {
    return this.step === lanes.step ? lanes.under(this, at) : null;
  }

  /** @param {Px} at */
  hover(at) {
    if (this.step === lanes.step) lanes.hover(this, at);
  }

  /**
   * Where a point goes: onto what is drawn already, in the step of the lanes.
   * @param {Px} at @param {MouseEvent} event @param {Handle} [held]
   * @returns {Px}
   */
  snapped(at, event, held) {
    if (this.step !== lanes.step || event.altKey) return at;
    return lanes.snapped(this, at, held);
  }

  /** @param {import("./types.js").Drawing | null} before what an undo or redo has replaced */
  changed(before) {
    if (before) this.swapped(before);
    this.isStale = true;
    this.kept.saveProblem = "";
    document.body.dataset.calm = "false";
    this.render();
    clearTimeout(this.kept.soon);
    this.kept.soon = setTimeout(() => this.measure(), SOON_MS);
  }

  /** After an undo or redo: what is selected or held may be gone. @param {import("./types.js").Drawing} before */
  swapped(before) {
    const { hand, selection, store } = this;
    const size = (/** @type {import("./types.js").Drawing} */ d) => (selection ? lists(d)[selection.kind].length : 0);
    if (size(before) !== size(store.drawing)) this.selection = null;
    hand.withdraw();
    hand.held = null;
    this.kept.key = 0;
    carry(this, before);
  }

  async measure() {
    if (this.isLooking || !this.isStale) return;
    this.isLooking = true;
    this.isStale = false;
    try {
      this.look = await server.look(this.store.drawing, this.version);
      this.failure = "";
    } catch (error) {
      this.failure = /** @type {Error} */ (error).message;
    }
    this.isLooking = false;
    this.render();
    if (this.isStale) this.measure();
    else document.body.dataset.calm = "true";
  }

  /** Shows the picture without traffic, a frame, or the picture of the old pose. */
  async showPicture() {
    const asked = (this.kept.asked = Symbol("picture"));
    const name = this.frame === null ? null : this.site.frames[this.frame];
    const address = this.shownOld ? "api/pose.png" : name === null ? "api/backdrop.png" : server.pictureAddress(name);
    try {
      const [image, shift] = await Promise.all([
        server.picture(address),
        name === null || this.shownOld ? null : server.shift(name),
      ]);
      if (this.kept.asked !== asked) return;
      this.kept.shift = shift?.sure ? shift.by : [0, 0];
      this.stage.show(image, this.kept.shift);
      this.kept.pictureProblem = "";
    } catch (error) {
      this.kept.pictureProblem = `${name ?? ""} ${/** @type {Error} */ (error).message}`;
    }
    this.render();
  }

  /** @param {number | null} frame */
  show(frame) {
    const n = this.site.frames.length;
    this.frame = frame === null ? null : ((frame % n) + n) % n;
    this.shownOld = false;
    this.showPicture();
  }

  render() {
    const { look, store } = this;
    fill(
      byId("steps"),
      ...STEPS.map((step, k) =>
        el("button", {
          class: step.done(this) ? "done" : "",
          "aria-current": k === this.at && "step",
          id: `step-${k + 1}`,
          onclick: () => this.go(k),
        }, el("span", { class: "number", text: step.done(this) ? "✓" : String(k + 1) }), step.name),
      ),
    );
    const verdict = byId("verdict");
    const camera = look?.camera;
    verdict.textContent = camera ? `lengths ± ${percent(camera.whole)}` : "";
    verdict.className = `verdict ${camera ? (camera.trust === "ok" ? "good" : "bad") : ""}`;
    /** @type {HTMLButtonElement} */ (byId("undo")).disabled = store.past.length === 0;
    /** @type {HTMLButtonElement} */ (byId("redo")).disabled = store.future.length === 0;
    fill(
      byId("tools"),
      ...(this.tools.length
        ? [
            ...this.tools.map((tool) => this.toolButton(tool, tool.name, tool.key)),
            this.toolButton(null, "Move", "V"),
          ]
        : []),
    );
    this.stage.loupe = this.magnifier && this.tools.length > 0;
    this.renderHint();
    this.renderBackdrops();
    fill(byId("panel"), this.asideCard(), this.draftCard(), this.movedCard(), this.siteProblem(), ...this.step.panel(this));
    fill(
      byId("legend"),
      ...(look?.dots.length && this.step === road.step
        ? [
            "6 m of road known to",
            ...ERRORS.map(([limit, colour]) => {
              const dot = el("i");
              dot.style.background = colour;
              return el("span", {}, dot, limit === Infinity ? "worse" : percent(limit));
            }),
          ]
        : []),
    );
    this.stage.paint();
  }

  renderHint() {
    const hint = byId("hint");
    const problem = this.failure || this.kept.pictureProblem;
    hint.textContent = problem || this.notice || this.tool?.hint || this.step.hint(this);
    hint.className = problem ? "bad-text" : this.notice ? "fair-text" : "";
  }

  /** @param {Tool | null} tool @param {string} name @param {string} key */
  toolButton(tool, name, key) {
    return el("button", { "aria-pressed": String(this.tool === tool), data: { tool: name }, onclick: () => this.take(tool) }, name, el("kbd", { text: key }));
  }

  renderBackdrops() {
    const { frame, site } = this;
    const name = frame === null ? "" : site.frames[frame];
    fill(
      byId("backdrops"),
      el("button", { class: "small", "aria-pressed": String(frame === null && !this.shownOld), onclick: () => this.show(null) }, "Without traffic"),
      el("button", { class: "small", "aria-pressed": String(frame !== null), onclick: () => this.show(frame ?? 0) }, "With traffic"),
      frame !== null && el("button", { class: "small", title: "Previous picture (,)", onclick: () => this.show(frame - 1) }, "‹"),
      frame !== null && el("span", { class: "name", text: name }),
      frame !== null && el("button", { class: "small", title: "Next picture (.)", onclick: () => this.show(frame + 1) }, "›"),
      el("button", { class: "small", title: "Magnifier (M)", "aria-pressed": String(this.magnifier), onclick: () => { this.magnifier = !this.magnifier; this.render(); } }, "Magnifier"),
      el("button", { class: "small", title: "Whole picture (0)", onclick: () => this.stage.fit() }, "Fit"),
    );
  }

  siteProblem() {
    const { problem } = this.site;
    return problem && el("div", { class: "card bad" }, el("b", { text: "This site cannot be saved. " }), problem);
  }

  /** What became of a drawing on other pictures that was not saved. */
  asideCard() {
    const { aside } = this.site;
    return aside && el("div", { class: "card fair", id: "aside", text: aside });
  }

  /** The page began with what was drawn before and not saved. */
  draftCard() {
    const { site } = this;
    if (!site.draft) return null;
    const keep = () => { site.draft = false; this.render(); };
    const drop = () => server.dropDraft().then(
      () => { this.store.changed = false; location.reload(); },
      (/** @type {Error} */ error) => { this.notice = error.message; this.render(); });
    return el("div", { class: "card fair", id: "draft" },
      "You are continuing a drawing that was not saved. ",
      el("div", { class: "actions" },
        el("button", { class: "primary", id: "keep-draft", onclick: keep }, "Go on with it"),
        el("button", { id: "drop-draft", onclick: drop }, "Drop it")));
  }

  /** The camera moved since the site was saved: a look and a click. */
  movedCard() {
    const { moved } = this;
    if (!moved) return null;
    const [du, dv] = moved.by;
    return el("div", { class: "card fair", id: "moved" },
      el("b", { text: "The camera has moved. " }),
      `By ${moved.displacement_px.toFixed(1)} px since this site was saved (${du.toFixed(1)} right, ${dv.toFixed(1)} down, turn ${moved.turn_deg.toFixed(1)}°, zoom ${moved.zoom.toFixed(3)}). Everything drawn was carried along: compare, mend points that are off, then confirm.`,
      el("div", { class: "actions" },
        el("button", { onclick: () => { this.shownOld = !this.shownOld; this.showPicture(); } }, this.shownOld ? "Show it now" : "Show it as it was"),
        el("button", { class: "primary", id: "confirm-moved", onclick: () => this.confirmMoved() }, "The points are right"),
      ),
    );
  }

  confirmMoved() {
    this.shownOld = false;
    this.store.edit((d) => { d.backdrop = this.site.backdrop; });
    this.showPicture();
  }

  listen() {
    byId("undo").addEventListener("click", () => this.undo());
    byId("redo").addEventListener("click", () => this.store.redo());
    keys.listen(this);
    window.addEventListener("pointerdown", () => this.unsay(), { capture: true });
    window.addEventListener("beforeunload", (event) => {
      if (this.store.changed || wrongFields(this).length) event.preventDefault();
    });
  }

  remove() {
    const { selection } = this;
    if (!selection) return;
    this.hand.withdraw();
    this.hand.held = null;
    this.selection = null;
    this.kept.key = 0;
    this.store.edit((d) => remove(d, selection));
  }
}

async function open() {
  const busy = byId("busy");
  try {
    const camera = await server.collection();
    const isAsked = camera.camera && (camera.state === "running" || camera.pictures === 0 || location.hash === "#collect");
    if (isAsked) await collect(camera);
    if (location.hash) history.replaceState(null, "", location.pathname);
    const site = await server.site();
    if (!site.saved && !site.draft) pictures.prefill(site);
    const desk = new Desk(site);
    await desk.showPicture();
    desk.stage.fit();
    busy.hidden = true;
    desk.go(isBlank(site.drawing) ? 0 : 1);
    desk.measure();
  } catch (error) {
    busy.textContent = `${/** @type {Error} */ (error).message}`;
  }
}

open();
