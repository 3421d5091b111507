"""Marks for recordings of the simulated street: what looks like a vehicle to a net and is none.

Draws words and symbols in lanes, overlays, closures, shadows of masts and leaves, and lorries nose to
tail, as keys of a scene (docs/explanation/street.md). `street.py --marks` adds them to its recordings.
"""

import json
import tomllib

WORDS = ["SLOW", "BUS", "BUS LANE", "KEEP CLEAR", "STOP", "TAXI", "TRAM", "ONLY", "SCHOOL", "AHEAD",
         "YIELD", "LOOK LEFT", "LOOK RIGHT", "XING", "A4", "M25", "30", "50", "80", "CYCLES", "NO ENTRY",
         "BUS STOP", "LOADING", "HOV", "AIRPORT", "TURN LEFT", "BIKE"]
TURNS = ["ahead", "left", "right", "ahead_left", "ahead_right"]
KINDS = ["word", "arrow", "cycle", "hatching", "stop_line", "give_way", "zebra"]
KIND_WEIGHTS = [0.28, 0.30, 0.12, 0.10, 0.07, 0.06, 0.07]
INKS = ["white", "yellow", "black", "red", "green", "blue"]
NAMES = ["CAM 12", "HIGHWAYS", "NATHAN RD", "I-80 AT MACE", "A-4 KM 12.5", "TMC NORTH", "DIST 3", "NO. 0417",
         "LOOKING NORTH", "PRESET 2", "TUNNEL EAST"]


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def draw(rng, scene_file):
    """Keys of a scene for one recording: another word, place and colour each time."""
    with open(scene_file, "rb") as file:
        scene = tomllib.load(file)
    find = {}
    far_m = scene["measure"]["far_m"]
    if rng.random() < 0.92:
        find["painted"] = [painted(rng, scene, far_m) for _ in range(rng.integers(2, 11))]
    if rng.random() < 0.8:
        find["overlay"] = overlays(rng)
    if rng.random() < 0.5:
        closures(rng, scene, far_m, find)
    if rng.random() < 0.7:
        find["roadside.shadow"] = shadows(rng, scene, far_m)
    if rng.random() < 0.4:
        lorries(rng, scene, find)
    return {key: value if isinstance(value, float) else toml(value) for key, value in find.items()}


def between(rng, low, high, digits=2):
    return round(float(rng.uniform(low, high)), digits)


def pick(rng, items, weights=None):
    return items[int(rng.choice(len(items), p=weights))]


def painted(rng, scene, far_m):
    mark = {"kind": pick(rng, KINDS, KIND_WEIGHTS), "at_m": between(rng, 12, 0.8 * far_m),
            "yellow": bool(rng.random() < 0.25), "worn": between(rng, 0, 0.9) if rng.random() < 0.6 else 0.0}
    if mark["kind"] == "zebra" and rng.random() < 0.7:
        left, right = scene["road"]["left_edge_m"], scene["road"]["right_edge_m"]
        return mark | {"offset_m": (left + right) / 2, "width_m": right - left, "length_m": between(rng, 2.4, 5)}
    mark["lane"] = int(rng.integers(1, len(scene["lane"]) + 1))
    if mark["kind"] == "word":
        mark |= {"text": pick(rng, WORDS), "length_m": between(rng, 1.4, 4)}
    elif mark["kind"] == "arrow":
        mark |= {"turn": pick(rng, TURNS), "length_m": between(rng, 2.5, 6), "width_m": between(rng, 0.9, 1.8)}
    elif mark["kind"] == "cycle":
        mark |= {"length_m": between(rng, 1.5, 3.5), "width_m": between(rng, 0.8, 1.5)}
    elif mark["kind"] == "hatching":
        mark |= {"length_m": between(rng, 4, 14)}
    return mark


def overlays(rng):
    size = between(rng, 7, 14, 1)
    dark = {"behind": "black"} if rng.random() < 0.4 else {}
    marks = [{"kind": "text", "x": between(rng, 0.01, 0.3), "y": float(pick(rng, [0.02, 0.05, 0.9, 0.94])),
              "size_px": size, "text": pick(rng, ["{time}", pick(rng, NAMES) + " {time}"]),
              "colour": pick(rng, ["white", "yellow", "white", "green"])} | dark]
    for _ in range(rng.integers(0, 4)):
        x, y = between(rng, 0.02, 0.85), between(rng, 0.02, 0.9)
        colour = pick(rng, INKS)
        kind = pick(rng, ["text", "arrow", "bar", "logo"])
        mark = {"kind": kind, "x": x, "y": y, "colour": colour, "opacity": between(rng, 0.5, 1)}
        if kind == "text":
            mark |= {"size_px": between(rng, 7, 22, 1), "text": pick(rng, NAMES)}
        elif kind == "arrow":
            mark |= {"size_px": between(rng, 14, 60, 1), "turn_deg": between(rng, -180, 180)}
        elif kind == "bar":
            # A wide band lies along the upper or lower end, else it would hide what the truth lists.
            wide = rng.random() < 0.6
            mark |= {"colour": pick(rng, ["black", "black", "black", "white", "blue", "yellow"]),
                     "size_px": between(rng, 8, 24, 1), "width": 1.0 if wide else between(rng, 0.05, 0.25)}
            if wide:
                mark |= {"x": 0.0, "y": float(pick(rng, [0.0, 0.9, 0.93])), "opacity": between(rng, 0.4, 1)}
        else:
            mark |= {"size_px": between(rng, 14, 45, 1), "behind": pick(rng, INKS)}
        marks.append(mark)
    return marks


def closures(rng, scene, far_m, find):
    """At an edge of the carriageway, or across a lane that is then shut."""
    rows = []
    left, right = scene["road"]["left_edge_m"], scene["road"]["right_edge_m"]
    for _ in range(rng.integers(1, 3)):
        start = between(rng, 8, 0.6 * far_m)
        row = {"kind": pick(rng, ["water", "concrete", "cone"]), "from_m": start,
               "to_m": start + between(rng, 6, 60)}
        if row["kind"] == "cone":
            row["gap_m"] = between(rng, 1.5, 8)
        elif rng.random() < 0.3:
            row["gap_m"] = between(rng, 0.3, 4)
        if rng.random() < 0.35:
            number = int(rng.integers(1, len(scene["lane"]) + 1))
            find[f"lane.{number}.inflow_veh_h"] = 0.0
            middle = scene["lane"][number - 1]["offset_m"]
            row |= {"offset_m": middle + between(rng, -1.4, 1.4), "to_offset_m": middle + between(rng, -1.4, 1.4)}
        else:
            row["offset_m"] = pick(rng, [left + 0.25, right - 0.25])
        rows.append(row)
    find["roadside.closure"] = rows


def shadows(rng, scene, far_m):
    found = []
    left, right = scene["road"]["left_edge_m"], scene["road"]["right_edge_m"]
    for _ in range(rng.integers(1, 7)):
        side = pick(rng, [left - between(rng, 1, 9), right + between(rng, 1, 9)])
        shadow = {"kind": pick(rng, ["mast", "leaves", "leaves", "gantry"]),
                  "at_m": between(rng, -10, 0.8 * far_m), "offset_m": side}
        if shadow["kind"] == "mast":
            shadow |= {"height_m": between(rng, 6, 25), "width_m": between(rng, 0.15, 0.7)}
        elif shadow["kind"] == "gantry":
            shadow |= {"height_m": between(rng, 5.5, 8), "offset_m": left - 1, "to_offset_m": right + 1,
                       "width_m": between(rng, 0.4, 2)}
        else:
            shadow |= {"height_m": between(rng, 6, 16), "width_m": between(rng, 5, 14)}
        found.append(shadow)
    return found


def lorries(rng, scene, find):
    """A share of trucks, most with trailers, in runs; half of the time in a slow queue."""
    find["fleet.truck"] = between(rng, 0.2, 1)
    find["fleet.trailer_share"] = between(rng, 0.3, 0.9)
    find["fleet.truck_run"] = between(rng, 2, 8)
    if rng.random() < 0.5:
        number = int(rng.integers(1, len(scene["lane"]) + 1))
        find[f"lane.{number}.slowdown"] = {"from_m": 2.0, "to_m": between(rng, 40, 100),
                                           "speed_km_h": between(rng, 4, 20)}
