// The drawing, and every state that it had: undo and redo.

/** @typedef {import("./types.js").Drawing} Drawing */

/** Steps that can be undone. */
const MOST = 200;
/** Changes of one thing within this time are one step, ms. */
const TOGETHER_MS = 1500;

export class Store {
  /** @param {Drawing} drawing */
  constructor(drawing) {
    this.drawing = drawing;
    /** @type {string[]} */
    this.past = [];
    /** @type {string[]} */
    this.future = [];
    /** @type {(() => void)[]} */
    this.listeners = [];
    this.last = { key: "", at: 0 };
    /** Whether something was changed since it was saved. */
    this.changed = false;
  }

  /** @param {() => void} listener */
  onChange(listener) {
    this.listeners.push(listener);
  }

  tell() {
    this.listeners.forEach((listener) => listener());
  }

  /**
   * Changes the drawing. Changes with the same key, one soon after the other, are one step.
   * @param {(drawing: Drawing) => void} change
   * @param {string} [key]
   */
  edit(change, key = "") {
    const now = performance.now();
    const together = key !== "" && key === this.last.key && now - this.last.at < TOGETHER_MS;
    if (!together) {
      this.past.push(JSON.stringify(this.drawing));
      if (this.past.length > MOST) this.past.shift();
    }
    this.last = { key, at: now };
    this.future = [];
    this.changed = true;
    change(this.drawing);
    this.tell();
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
    to.push(JSON.stringify(this.drawing));
    this.drawing = JSON.parse(state);
    this.last = { key: "", at: 0 };
    this.changed = true;
    this.tell();
  }
}
