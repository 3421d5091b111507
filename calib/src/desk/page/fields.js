// Fields for numbers. A text that is no number stays in its field, red and with the reason, until
// it is mended; the drawing has no value meanwhile, and is not saved.

import { el } from "./elements.js";

/** @typedef {import("./types.js").Drawing} Drawing */
/** @typedef {import("./types.js").Length} Length */
/** @typedef {import("./main.js").Desk} Desk */
/**
 * @typedef {Object} Field
 * @property {unknown} id whose text it is: the length itself, or the field's key
 * @property {string} key
 * @property {"m" | "s"} unit
 * @property {number} least
 * @property {number} most
 * @property {(d: Drawing) => string} name
 * @property {(d: Drawing) => number | null | undefined} of `null` where none is given, `undefined` where the field is gone
 * @property {(d: Drawing, value: number | null) => void} set
 */
/** @typedef {{field: Field, text: string, why: string}} Wrong */

const NUMBER = /^([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:e[+-]?\d+)?)\s*(\p{L}*)$/iu;
/** Longer than any road in a picture; beyond it is a slip. */
const METRES = { unit: /** @type {const} */ ("m"), least: 0.01, most: 10000 };

/** @type {Field} */
export const laneWidth = {
  ...METRES, id: "lane width", key: "lane width", name: () => "Width of the lanes",
  of: (d) => d.lane_width_m, set: (d, value) => { d.lane_width_m = value; },
};
/** @type {Field} */
export const cameraHeight = {
  ...METRES, id: "camera height", key: "camera height", name: () => "Height of the camera",
  of: (d) => d.height_m, set: (d, value) => { d.height_m = value; },
};
/** Bounds are those of the sensor's windows. @type {Field} */
export const interval = {
  unit: "s", least: 0.01, most: 900, id: "interval", key: "interval", name: () => "Seconds between pictures",
  of: (d) => d.interval_s, set: (d, value) => { d.interval_s = value; },
};
/** @param {Length} s @param {number} index @returns {Field} */
export const metresOf = (s, index) => ({
  ...METRES, id: s, key: `length-${index}`, name: (d) => `Length ${d.lengths.indexOf(s) + 1}`,
  of: (d) => (d.lengths.includes(s) && s.standard === null ? s.metres : undefined),
  set: (_, value) => { s.metres = value; },
});

/**
 * The number of a text, or why it is none. A decimal comma and the unit behind it are taken.
 * @param {string} text @param {Field} field
 * @returns {{value: number | null, why: string}}
 */
function read(text, { unit, least, most }) {
  const wrong = (/** @type {string} */ why) => ({ value: null, why });
  const plain = text.trim();
  if (!plain) return wrong("");
  const [, digits, behind] = NUMBER.exec(plain) ?? [];
  if (!digits || (behind && behind.toLowerCase() !== unit)) return wrong(`type ${unit === "m" ? "metres" : "seconds"} as a number, such as 12.5`);
  const value = Number(digits.replace(",", "."));
  if (!(value > 0)) return wrong("must be more than 0");
  if (value < least || value > most) return wrong(`must be between ${least} and ${most} ${unit}`);
  return { value, why: "" };
}

/** The fields that are wrong now; those that an undo or a removal has settled are forgotten. @param {Desk} desk @returns {Wrong[]} */
export function wrongFields(desk) {
  for (const [id, { field }] of desk.wrong) if (field.of(desk.store.drawing) !== null) desk.wrong.delete(id);
  return [...desk.wrong.values()];
}

/** An undo makes new lengths: a wrong text goes on with the length in the same place. @param {Desk} desk @param {Drawing} before */
export function carry(desk, before) {
  const now = desk.store.drawing.lengths;
  before.lengths.forEach((s, k) => {
    const wrong = desk.wrong.get(s);
    if (wrong && String(now[k]?.points) === String(s.points)) desk.wrong.set(now[k], { ...wrong, field: metresOf(now[k], k) });
  });
}

/**
 * The field itself; empty is none.
 * @param {Desk} desk @param {Field} field @param {number | null} [unset] what holds where none is given
 */
export function input(desk, field, unset = null) {
  const wrong = wrongFields(desk).find((w) => w.field.id === field.id);
  const value = field.of(desk.store.drawing) ?? null;
  const shown = value ?? unset;
  const element = el("input", {
    class: "metres", type: "text", inputmode: "decimal", placeholder: field.unit, autocomplete: "off", data: { key: field.key },
    value: wrong ? wrong.text : shown === null ? "" : String(shown),
    "aria-label": `${field.name(desk.store.drawing)} in ${field.unit}`, "aria-invalid": wrong && "true",
    oninput: () => {
      const text = element.value;
      const now = read(text, field);
      if (now.why) desk.wrong.set(field.id, { field, text, why: now.why });
      else desk.wrong.delete(field.id);
      if (now.value === value) desk.render();
      else desk.store.edit((d) => field.set(d, now.value), field.key);
    },
    onkeydown: (/** @type {KeyboardEvent} */ event) => {
      if (event.key === "Enter") element.blur();
    },
  });
  return element;
}

/** Why the field is wrong. @param {Desk} desk @param {Field} field */
export function reason(desk, field) {
  const wrong = wrongFields(desk).find((w) => w.field.id === field.id);
  return wrong ? el("span", { class: "wide bad-text wrong", role: "alert", text: wrong.why }) : null;
}

/** The field in a row of its own, with its name. @param {Desk} desk @param {Field} field @param {number | null} [unset] */
export const row = (desk, field, unset) => [
  el("label", { class: "row" }, el("span", { text: field.name(desk.store.drawing) }), input(desk, field, unset)),
  reason(desk, field),
];
