"""Frames of the simulated street for training: other cameras and seeds than those of the tests.

    python3 detector/train/street.py --street target/release/street --out DIR [--recordings 48]

Each recording has a camera of its own (height, tilt, pan, focal length), light and traffic, and
a few frames far apart. Resumable: recordings that are there stay. With --marks each has marks of its own
too (`marks.py`); the other draws stay as they are.
"""

import argparse
import os
import subprocess

import numpy as np

import marks

HERE = os.path.dirname(os.path.abspath(__file__))
SCENES = os.path.join(HERE, "..", "..", "street", "scenes")
# Scene, then the range of height (m), tilt (deg), pan (deg) and focal length (px).
CAMERAS = [("curve", (8, 24), (13, 24), (-10, 8), (300, 460)),
           ("freeway", (7, 16), (9, 18), (-6, 12), (560, 900))]
LIGHTS = [("day", 0.0), ("day", 0.0), ("dusk", 0.0), ("night", 0.0), ("night", 0.7), ("day", 0.7)]
INTERVAL_S = 20
# Marks have a stream of random numbers of their own.
MARKS = 1
# Exit code of `street`: the camera sees too little of the road.
BAD_SCENE = 65


def keys(rng, camera, light):
    scene, *ranges = camera
    names = ("height_m", "tilt_deg", "pan_deg", "focal_px")
    found = {f"camera.{name}": round(float(rng.uniform(*limits)), 2)
             for name, limits in zip(names, ranges)}
    found["light.daylight"], found["light.rain"] = light
    found["light.cloud"] = round(float(rng.uniform(0, 1)), 2)
    found["light.sun_azimuth_deg"] = round(float(rng.uniform(0, 360)), 1)
    found["imaging.jpeg_quality"] = int(rng.integers(35, 90))
    found["imaging.blur_px"] = round(float(rng.uniform(0.3, 1.0)), 2)
    found["interval_s"] = float(INTERVAL_S)
    return scene, found


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--street", required=True, help="the program")
    args.add_argument("--out", required=True)
    args.add_argument("--recordings", type=int, default=48)
    args.add_argument("--seed", type=int, default=20210320)
    args.add_argument("--frames", type=int, default=8)
    args.add_argument("--marks", action="store_true", help="add painted marks, overlays, closures, "
                      "shadows and lorries with trailers, drawn for each recording")
    args = args.parse_args()
    os.makedirs(args.out, exist_ok=True)
    for n in range(args.recordings):
        rng = np.random.default_rng([args.seed, n])
        marks_rng = np.random.default_rng([args.seed, n, MARKS])
        scene = CAMERAS[n % len(CAMERAS)][0]
        out = os.path.join(args.out, f"{scene}_{n:03d}")
        while not os.path.exists(out):
            scene, chosen = keys(rng, CAMERAS[n % len(CAMERAS)], LIGHTS[n // 2 % len(LIGHTS)])
            if args.marks:
                chosen |= marks.draw(marks_rng, os.path.join(SCENES, f"{scene}.toml"))
            record(args.street, out, args.frames, 1000 + n, scene, chosen)


def record(street, out, frames, seed, scene, chosen):
    """Leaves nothing where the camera sees too little of the road: another is drawn then."""
    line = [street, "record", "--scene", os.path.join(SCENES, f"{scene}.toml"),
            "--frames", str(frames), "--seed", str(seed), "--out", out]
    for key, value in chosen.items():
        line += ["--set", f"{key}={value}"]
    done = subprocess.run(line, capture_output=True, text=True)
    if done.returncode not in (0, BAD_SCENE):
        raise RuntimeError(done.stderr)


if __name__ == "__main__":
    main()
