// What the keys do.

import { handles, moveHandle } from "./tools.js";

/** @typedef {import("./main.js").Desk} Desk */

/** @param {Desk} desk */
export function listen(desk) {
  window.addEventListener("keydown", (event) => pressed(desk, event));
  window.addEventListener("keyup", (event) => {
    if (event.key === " ") desk.stage.space = false;
  });
}

/** @param {Desk} desk @param {KeyboardEvent} event */
function pressed(desk, event) {
  const target = /** @type {HTMLElement} */ (event.target);
  const typing = target.tagName === "INPUT" || target.tagName === "SELECT";
  const control = event.ctrlKey || event.metaKey;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  desk.unsay();
  if (control && (key === "z" || key === "y")) {
    if (typing) target.blur();
    event.preventDefault();
    if (key === "y" || event.shiftKey) desk.store.redo();
    else desk.undo();
    return;
  }
  if (typing || control || event.altKey) return;
  if (did(desk, key, event)) event.preventDefault();
}

/** @param {Desk} desk @param {string} key @param {KeyboardEvent} event @returns {boolean} whether it means something */
function did(desk, key, event) {
  const { hand, stage } = desk;
  const onButton = /** @type {HTMLElement} */ (event.target).tagName === "BUTTON";
  if (/^[0-9.,]$/.test(key) && openMetres(desk)) return false;
  if (key === "Enter" && !onButton) hand.finish();
  else if (key === "Escape") {
    if (hand.pending.length) hand.cancel();
    else desk.select(null);
  } else if ((key === "Delete" || key === "Backspace") && desk.selection) desk.remove();
  else if (key === "Backspace" && hand.pending.length) {
    hand.pending.pop();
    stage.paint();
  } else if (key.startsWith("Arrow")) return nudge(desk, key, event.shiftKey ? 2 : 0.25);
  else if (key === "+" || key === "=") stage.zoom(1.25);
  else if (key === "-") stage.zoom(0.8);
  else if (key === "0") stage.fit();
  else if (key === "m") {
    desk.magnifier = !desk.magnifier;
    desk.render();
  } else if (key === "b") desk.show(desk.frame === null ? 0 : null);
  else if (key === ",") desk.show((desk.frame ?? 1) - 1);
  else if (key === ".") desk.show((desk.frame ?? -1) + 1);
  else if (key === " " && !onButton) stage.space = true;
  else if (key === "v" && desk.tools.length) desk.take(null);
  else if (/^F?[1-6]$/.test(key) && event.shiftKey) desk.go(Number(key.replace("F", "")) - 1);
  else if (key === "PageDown") desk.go(desk.at + 1);
  else if (key === "PageUp") desk.go(desk.at - 1);
  else {
    const tool = desk.tools.find((t) => t.key.toLowerCase() === key);
    if (tool) desk.take(tool);
    else return desk.step.key?.(desk, key) ?? false;
  }
  return true;
}

/** Digits go to the selected length that waits for its metres. @param {Desk} desk */
function openMetres(desk) {
  const { selection, store } = desk;
  if (selection?.kind !== "length") return false;
  const { metres, standard } = store.drawing.lengths[selection.index];
  const field = /** @type {HTMLInputElement | null} */ (document.querySelector(`[data-key="length-${selection.index}"]`));
  if (metres !== null || standard !== null || !field) return false;
  desk.hand.withdraw();
  field.focus();
  return true;
}

/** Moves the point under the mouse, else all points of what is selected. @param {Desk} desk @param {string} key @param {number} px */
function nudge(desk, key, px) {
  const { selection } = desk;
  const { mouse } = desk.stage;
  const near = mouse && desk.hand.near(desk.stage.toPicture(mouse));
  const moved = handles(desk.store.drawing, desk.movable()).filter((h) =>
    near ? h.kind === near.kind && h.index === near.index && h.point === near.point
      : selection && h.kind === selection.kind && h.index === selection.index,
  );
  if (!moved.length) return false;
  const by = { ArrowLeft: [-px, 0], ArrowRight: [px, 0], ArrowUp: [0, -px], ArrowDown: [0, px] }[key] ?? [0, 0];
  desk.hand.withdraw();
  desk.store.edit(
    (d) => moved.forEach((h) => moveHandle(d, h, [h.at[0] + by[0], h.at[1] + by[1]])),
    `nudge ${moved[0].kind} ${moved[0].index}`,
  );
  return true;
}
