// Elements of the page from their parts. Text is always set as text.

/**
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Record<string, any>} [properties] `class`, `text`, `data`, `on…` handlers, attributes
 * @param {...(Node | string | null | undefined | false)} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null || value === false) continue;
    if (name === "text") element.textContent = value;
    else if (name === "class") element.className = value;
    else if (name === "data") Object.assign(element.dataset, value);
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "value") /** @type {HTMLInputElement} */ (element).value = value;
    else if (name === "checked") /** @type {HTMLInputElement} */ (element).checked = value;
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((c) => c !== null && c !== undefined && c !== false).map((c) => /** @type {Node | string} */ (c)));
  return element;
}

/**
 * Puts new content into a place; the field that is typed in keeps its focus and text.
 * @param {HTMLElement} place
 * @param {...(Node | string | null | undefined | false)} children
 */
export function fill(place, ...children) {
  const active = /** @type {HTMLInputElement | null} */ (
    place.contains(document.activeElement) ? document.activeElement : null
  );
  const key = active?.dataset.key;
  const text = active?.value;
  const isText = active?.tagName === "INPUT" && active.type === "text";
  const range = isText ? [active.selectionStart, active.selectionEnd] : null;
  const scroll = place.scrollTop;
  place.replaceChildren(...children.filter((c) => c !== null && c !== undefined && c !== false).map((c) => /** @type {Node | string} */ (c)));
  place.scrollTop = scroll;
  if (!key) return;
  const again = /** @type {HTMLInputElement | null} */ (place.querySelector(`[data-key="${key}"]`));
  if (!again) return;
  if (isText && text !== undefined) again.value = text;
  again.focus({ preventScroll: true });
  if (range) again.setSelectionRange(range[0], range[1]);
}

/** @param {string} id @returns {HTMLElement} */
export function byId(id) {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no ${id}`);
  return element;
}

/** @param {number} part */
export const percent = (part) => `${(100 * part).toFixed(part < 0.1 ? 1 : 0)} %`;

/**
 * A field for metres; empty is none.
 * @param {string} key
 * @param {number | null} value
 * @param {(value: number | null) => void} change
 * @param {string} [unit]
 */
export function metres(key, value, change, unit = "m") {
  const input = el("input", {
    class: "metres", type: "text", inputmode: "decimal", placeholder: unit, data: { key },
    value: value === null ? "" : String(value), "aria-label": `${key} in ${unit}`,
    oninput: () => {
      const text = input.value.trim().replace(",", ".");
      const number = Number(text);
      const wrong = text !== "" && !(Number.isFinite(number) && number > 0);
      input.setAttribute("aria-invalid", String(wrong));
      input.style.borderColor = wrong ? "var(--bad)" : "";
      change(text === "" || wrong ? null : number);
    },
    onkeydown: (/** @type {KeyboardEvent} */ event) => {
      if (event.key === "Enter") input.blur();
    },
  });
  return input;
}
