// What the page and the server say to each other: the drawing (calib/src/desk/drawing.rs) and
// the answers (look.rs, traffic.rs, server.rs). Types alone, for the checker.

/** @typedef {[number, number]} Px A point of the picture, px. */

/**
 * @typedef {Object} Length
 * @property {Px[]} points
 * @property {number | null} metres
 * @property {string | null} standard
 */
/** @typedef {{id: number, points: Px[]}} Line */
/** @typedef {{body: string, points: Record<string, Px>}} Vehicle */
/**
 * @typedef {Object} Lane
 * @property {number} number
 * @property {string} direction
 * @property {boolean} widens
 * @property {Px[]} polygon
 */
/**
 * @typedef {Object} Drawing
 * @property {string} format
 * @property {number} version
 * @property {[number, number]} image_size
 * @property {string} backdrop
 * @property {string} site
 * @property {string} camera_id
 * @property {string} source
 * @property {number | null} interval_s
 * @property {Length[]} lengths
 * @property {Line[]} lines
 * @property {[number, number][]} apart
 * @property {[Px, Px, Px, Px][]} rectangles
 * @property {Vehicle[]} vehicles
 * @property {number | null} lane_width_m
 * @property {number | null} height_m
 * @property {boolean} use_traffic
 * @property {Lane[]} lanes
 * @property {Px[][]} ignored
 */

/**
 * @typedef {Object} CameraLook
 * @property {number} f_px
 * @property {number} height_m
 * @property {number} tilt_deg
 * @property {string} trust
 * @property {{at: Px, along: number, across: number}[]} errors
 * @property {{along: number, across: number}} limits
 * @property {number} whole
 * @property {{used: number, longer: number, longer_sd: number} | null} traffic
 */
/** @typedef {{known_m: number, measured_m: number, in_sd: number, doubt: string | null, is_contradicted: boolean}} LengthLook */
/** @typedef {{sides_m: [number, number], angle_deg: number, in_sd: number}} RectangleLook */
/** @typedef {{lines: [number, number], width_m: [number, number, number] | null, width_err: [number, number, number] | null, outline: Px[]}} StripLook */
/** @typedef {{line: number, points: Px[], pitch_m: number | null, problem: string | null}} LineDashes */
/** @typedef {{misfit_px: number | null, problem: string | null}} VehicleLook */
/**
 * @typedef {Object} LaneMeasured
 * @property {number} length_m
 * @property {number} near_width_m
 * @property {number} far_width_m
 * @property {number} far_span_m
 * @property {number | null} rel_err
 * @property {Px[]} middle
 */
/** @typedef {{problem: string | null, measured: LaneMeasured | null}} LaneLook */
/**
 * @typedef {Object} Look
 * @property {CameraLook | null} camera
 * @property {string | null} problem
 * @property {string[]} [problems] what forbids to save, beside `camera.trust`
 * @property {(LengthLook | null)[]} lengths
 * @property {RectangleLook[]} rectangles
 * @property {StripLook[]} strips
 * @property {VehicleLook[]} vehicles
 * @property {[number, number, number][]} dots
 * @property {LaneLook[]} lanes
 * @property {string | null} lanes_problem
 * @property {number} fit_ms
 */

/** @typedef {{by: Px, turn_deg: number, zoom: number, displacement_px: number, sure: boolean}} Shift */
/**
 * @typedef {Object} TrafficState
 * @property {boolean} detector
 * @property {"idle" | "running" | "done" | "failed"} state
 * @property {number} running_s
 * @property {number} searched
 * @property {string | null} problem
 * @property {number} frames
 * @property {number} boxes
 */
/**
 * @typedef {Object} CollectionState
 * @property {string | null} camera
 * @property {"idle" | "running" | "done" | "failed"} state
 * @property {number} running_s
 * @property {number} interval_s
 * @property {number} for_s
 * @property {number} collected
 * @property {string | null} latest
 * @property {number} pictures
 * @property {string | null} problem
 */
/**
 * @typedef {Object} AuditResult
 * @property {{frame: string, people: number, line: number}[]} frames
 * @property {number} vehicles
 * @property {number} stated_score
 * @property {{score: number | null, by_load: {counted: number, factor: number, factor_se: number}[], vehicles_se: number}} correction
 */
/**
 * @typedef {Object} AuditState
 * @property {boolean} detector
 * @property {number[]} lanes
 * @property {boolean} audited
 * @property {"idle" | "running" | "done" | "failed"} choosing
 * @property {string[]} frames
 * @property {"idle" | "running" | "done" | "failed"} comparing
 * @property {number} running_s
 * @property {AuditResult | null} result
 * @property {string | null} problem
 */
/**
 * @typedef {Object} Site
 * @property {string} folder
 * @property {string[]} frames
 * @property {string[]} used
 * @property {[string, string][]} left_out
 * @property {[number, number]} image_size
 * @property {string} backdrop
 * @property {Drawing} drawing
 * @property {boolean} saved whether exactly this drawing is saved
 * @property {number} version
 * @property {boolean} draft whether the drawing is one that was not saved
 * @property {string | null} aside what became of a drawing on other pictures that was not saved
 * @property {Shift | null} moved
 * @property {string | null} problem
 * @property {{name: string, what: string, pitch_m: number}[]} standards
 * @property {string[]} key_points
 * @property {number | null} interval_s
 * @property {TrafficState} traffic
 * @property {string | null} camera
 * @property {string | null} source
 */
/** @typedef {{corners: [number, number, number, number], score: number, class: string, lane: number | null, s_m: number | null}} Counted */
/** @typedef {{frames: {frame: string, boxes: Counted[]}[], lanes: {lane: number, length_m: number, vehicles: number}[]}} Counts */
/** @typedef {{folder: string, files: [string, string][], version: number}} Saved */

/**
 * A thing that can be taken with the mouse.
 * @typedef {Object} Handle
 * @property {"length" | "line" | "rectangle" | "vehicle" | "lane" | "ignored"} kind
 * @property {number} index
 * @property {string} point
 * @property {Px} at
 */
/** @typedef {{kind: Handle["kind"], index: number} | null} Selection */

export {};
