// The drawing, and every state that it had: undo and redo.

/** @typedef {import("./types.js").Drawing} Drawing */

/** Steps that can be undone. */
const MOST = 200;
/** Changes of one thing within this time are one step, ms. */
const TOGETHER_MS = 1500;

/** Whether nothing is drawn nor known. @param {Drawing} d */
export const isBlank = (d) =>
  [d.lengths, d.lines, d.rectangles, d.vehicles, d.lanes, d.ignored].every((list) => list.length === 0)
  && d.lane_width_m === null && d.height_m === null;

export class Store {
  /** @param {Drawing} drawing @param {boolean} isSaved */
  constructor(drawing, isSaved) {
    this.drawing = drawing;
    /** @type {string[]} */
    this.past = [];
    /** @type {string[]} */
    this.future = [];
    /** @type {((before: Drawing | null) => void)[]} */
    this.listeners = [];
    this.last = { key: "", at: 0 };
    /** What needs no saving: what was saved, or that nothing is drawn. */
    this.savedText = isSaved || isBlank(drawing) ? JSON.stringify(drawing) : "";
    /** Whether something was changed since it was saved. */
    this.changed = this.savedText === "";
  }

  /** @param {(before: Drawing | null) => void} listener gets what an undo or redo has replaced */
  onChange(listener) {
    this.listeners.push(listener);
  }

  /** @param {Drawing | null} before */
  tell(before) {
    this.compare();
    this.listeners.forEach((listener) => listener(before));
  }

  compare() {
    this.changed = JSON.stringify(this.drawing) !== this.savedText;
  }

  /** Says which drawing was saved: the present one may have gone on since. @param {string} text */
  saved(text) {
    this.savedText = text;
    this.compare();
  }

  /**
   * Changes the drawing. Changes with the same key, one soon after the other, are one step.
   * @param {(drawing: Drawing) => void} change
   * @param {string} [key]
   */
  edit(change, key = "") {
    const now = performance.now();
    const together = key !== "" && key === this.last.key && now - this.last.at < TOGETHER_MS;
    const before = together ? "" : JSON.stringify(this.drawing);
    // A change that fails leaves no step, and what was undone can still be redone.
    change(this.drawing);
    if (!together) {
      this.past.push(before);
      if (this.past.length > MOST) this.past.shift();
    }
    this.last = { key, at: now };
    this.future = [];
    this.tell(null);
  }

  undo() {
    this.swap(this.past, this.future);
  }

  redo() {
    this.swap(this.future, this.past);
  }

  /**
   * @param {string[]} from
   * @param {string[]} to
   */
  swap(from, to) {
    const state = from.pop();
    if (state === undefined) return;
    const before = this.drawing;
    to.push(JSON.stringify(before));
    this.drawing = JSON.parse(state);
    this.last = { key: "", at: 0 };
    this.tell(before);
  }
}
