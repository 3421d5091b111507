// What the page asks the program for. Every address is relative: the token is in the page's own.

/** @typedef {import("./types.js").Drawing} Drawing */

const GONE = "The desk's program has ended. Start `mvcalib desk` again and open its new address: it continues with what you had drawn until then; what you draw on this page now will be lost.";

/**
 * @param {Response} response
 * @returns {Promise<any>}
 */
async function content(response) {
  const isJson = (response.headers.get("Content-Type") || "").includes("json");
  const value = isJson ? await response.json() : { error: (await response.text()).trim() };
  if (!response.ok) throw new Error(value.error || response.statusText);
  return value;
}

/**
 * @param {string} path @param {RequestInit} how
 * @returns {Promise<any>}
 */
async function asked(path, how) {
  /** @type {Response} */
  let response;
  try {
    response = await fetch(path, how);
  } catch {
    throw new Error(GONE);
  }
  return content(response);
}

/**
 * @param {string} path
 * @returns {Promise<any>}
 */
const get = (path) => asked(path, {});

/**
 * @param {string} path
 * @param {unknown} value
 * @returns {Promise<any>}
 */
const post = (path, value) =>
  asked(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(value),
  });

/** @returns {Promise<import("./types.js").Site>} */
export const site = () => get("api/site");
/** @param {Drawing} drawing @param {number} version the drawing that this page went on from @returns {Promise<import("./types.js").Look>} */
export const look = (drawing, version) => post(`api/look/${version}`, drawing);
/** @param {Drawing} drawing @param {number} version the drawing that this page went on from @returns {Promise<import("./types.js").Saved>} */
export const save = (drawing, version) => post(`api/save/${version}`, drawing);
/** @param {Drawing} drawing @returns {Promise<import("./types.js").LineDashes[]>} */
export const dashes = (drawing) => post("api/dashes", drawing);
/** @param {Drawing} drawing @returns {Promise<import("./types.js").Counts>} */
export const count = (drawing) => post("api/count", drawing);
/** @returns {Promise<import("./types.js").TrafficState>} */
export const traffic = () => get("api/traffic");
/** @returns {Promise<import("./types.js").TrafficState>} */
export const search = () => post("api/traffic", {});
/** @returns {Promise<unknown>} */
export const dropDraft = () => post("api/draft/drop", {});
/** @returns {Promise<import("./types.js").AuditState>} */
export const audit = () => get("api/audit");
/** @returns {Promise<import("./types.js").AuditState>} */
export const chooseAudit = () => post("api/audit/choose", {});
/** @param {unknown} answers @returns {Promise<import("./types.js").AuditState>} */
export const compareAudit = (answers) => post("api/audit/compare", answers);
/** @returns {Promise<import("./types.js").CollectionState>} */
export const collection = () => get("api/collect");
/** @param {number} interval_s @param {number} for_s @returns {Promise<import("./types.js").CollectionState>} */
export const collect = (interval_s, for_s) => post("api/collect", { interval_s, for_s });
/** @returns {Promise<import("./types.js").CollectionState>} */
export const stopCollecting = () => post("api/collect/stop", {});
/** @returns {Promise<import("./types.js").CollectionState>} */
export const useCollected = () => post("api/collect/use", {});
/** @param {string} name @returns {Promise<import("./types.js").Shift>} */
export const shift = (name) => get(`api/shift/${encodeURIComponent(name)}`);

/** @param {string} name */
export const pictureAddress = (name) => `api/picture/${encodeURIComponent(name)}`;

/**
 * @param {string} address
 * @returns {Promise<HTMLImageElement>}
 */
export async function picture(address) {
  const image = new Image();
  image.src = address;
  try {
    await image.decode();
  } catch {
    // An image does not say why: a program that has ended is told from a picture that is broken.
    await collection();
    throw new Error("the picture cannot be shown");
  }
  return image;
}
