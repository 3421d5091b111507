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
 * A number with its noun.
 * @param {number} n @param {string} one @param {string} [more]
 */
export const many = (n, one, more = `${one}s`) => `${n} ${n === 1 ? one : more}`;
