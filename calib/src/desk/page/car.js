// The drawing of a car with its thirteen key points, beside which they are clicked.

const SPACE = "http://www.w3.org/2000/svg";

/** Where each key point is drawn: front view to the left, rear view to the right. @type {[number, number][]} */
const PLACES = [
  [34, 92], [136, 92], [85, 108], [85, 66], [20, 62], [150, 62],
  [214, 74], [316, 74], [222, 92], [308, 92], [265, 102], [265, 34], [265, 118],
];

/**
 * @param {string} tag
 * @param {Record<string, string | number>} attributes
 * @param {string} [text]
 */
function shape(tag, attributes, text = "") {
  const element = document.createElementNS(SPACE, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.textContent = text;
  return element;
}

/** @param {number} x */
const outline = (x) => [
  shape("path", { class: "body", d: `M${x + 22} 128 V84 Q${x + 24} 66 ${x + 34} 60 L${x + 46} 34 Q${x + 52} 26 ${x + 85} 26 T${x + 124} 34 L${x + 136} 60 Q${x + 146} 66 ${x + 148} 84 V128 Z` }),
  shape("path", { class: "glass", d: `M${x + 42} 60 L${x + 53} 37 Q${x + 85} 32 ${x + 117} 37 L${x + 128} 60 Z` }),
  shape("rect", { class: "glass", x: x + 28, y: 126, width: 20, height: 12, rx: 3 }),
  shape("rect", { class: "glass", x: x + 122, y: 126, width: 20, height: 12, rx: 3 }),
];

/**
 * @param {string[]} names
 * @param {Record<string, unknown>} set the points that are set
 * @param {number} next the point that is set next; 0 for none
 * @param {(key: number) => void} choose
 */
export function carFigure(names, set, next, choose) {
  const svg = shape("svg", { class: "car", viewBox: "0 0 350 172", role: "group", "aria-label": "Key points of a vehicle" });
  svg.append(...outline(0), ...outline(180));
  svg.append(shape("text", { class: "caption", x: 85, y: 14 }, "from the front"), shape("text", { class: "caption", x: 265, y: 14 }, "from behind"));
  PLACES.forEach(([x, y], k) => {
    const key = k + 1;
    const state = key === next ? "next" : set[key] ? "set" : "";
    const dot = shape("circle", { class: `key ${state}`, cx: x, cy: y, r: 10 });
    dot.append(shape("title", {}, `${key}: ${names[k]}`));
    dot.addEventListener("click", () => choose(key));
    svg.append(dot, shape("text", { x, y }, String(key)));
  });
  svg.append(shape("text", { class: "caption", x: 175, y: 160 }, next ? `next: ${next}, ${names[next - 1]}` : "all points are set"));
  return svg;
}
