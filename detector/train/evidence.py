"""Fits the weights by which boxes are taken for vehicles, and counts the cameras left out of the fit.

    python3 detector/train/evidence.py --data DIR --street DIR [--counts FILE] [--camera NAME]

Truth: the audited frames (`detector/data/audit`), K109F's labels, the committed street recordings and
those that `street.py --seed 777 --frames 16` has made. The choice is that of `src/evidence/mod.rs` and
`src/scene/empty.rs`, written once more with numpy; here the empty road is the median of all frames of
a camera in one light.

First a logistic regression over boxes: which are vehicles that no better box has. Its threshold
does not count right where vehicles hide each other, so that a second fit, held to the first one by a
ridge, brings the counts of each camera together with the truth. Prints the weights as the model's
sidecar has them; with `--counts` writes what each camera counts with weights that were fitted without
it, for `coverage.py`.
"""

import argparse
import json
import os
import tempfile

import numpy as np
from scipy.optimize import minimize

import data
from evidence_frames import MODEL, UNARY, audited, committed, field, grid, prepare, street

MATCH = 0.4  # overlap with a vehicle from which a box is that vehicle
PAIR = ["inside", "inside_squared", "overlap", "beside", "apart", "behind"]
QUEUE = ["chain_inside", "chain"]
FULL = 6  # vehicles around a box that make the fullest queue
# Cameras of the street with a queue, and the paper's, weigh more: they are few, or crowded.
STREET_WEIGHT, K109F_WEIGHT = 3.0, 3.0
RIDGE = 0.05  # how strongly the counts' fit is held to the boxes'
STEEP = 3.0  # how steep the threshold is in it
LEAST = (0.2, 0.25, 0.3, 0.35, 0.4, 0.425, 0.45, 0.475, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8)
PHOTOGRAPHS = ("1004", "1005", "1503", "2702", "2703", "3704", "8704", "8706")


def choose(frame, weights, rows=None, least=0.5):
    """Boxes that count; `rows` gathers what the fits need."""
    alone = frame.alone @ weights[:len(UNARY)]
    threshold = np.log(least / (1 - least))
    kept, taken = [], np.zeros(len(frame.true), bool)
    for i in np.argsort(-alone, kind="stable"):
        terms = np.zeros(len(PAIR) + len(QUEUE), np.float32)
        if kept:
            inside = frame.smaller[i, kept]
            best = int(inside.argmax())
            if inside[best] > 0:
                terms[:len(PAIR)] = frame.pairs[i, kept[best]]
            queue = min(int(frame.queue[i, kept].sum()), FULL) / FULL
            terms[len(PAIR):] = queue * inside[best], queue
        evidence = alone[i] + terms @ weights[len(UNARY):]
        free = np.where(taken, 0, frame.on_true[i])
        hit = free.size > 0 and free.max() >= MATCH
        if rows is not None and frame.in_lanes[i] and not (hit and frame.hidden[free.argmax()]):
            rows.append((np.concatenate([frame.alone[i], terms]), float(hit), frame))
        if evidence >= threshold:
            kept.append(i)
            if hit:
                taken[free.argmax()] = True
    return kept, int(frame.in_lanes[kept].sum()) - int((taken & frame.hidden).sum())


def rows_of(frames, weights):
    rows = []
    for frame in frames:
        choose(frame, weights, rows)
    names, camera, count = np.unique([r[2].camera for r in rows], return_inverse=True,
                                     return_counts=True)
    share = count[camera] ** -0.5
    number = {id(frame): n for n, frame in enumerate(frames)}
    of = np.array([number[id(r[2])] for r in rows])
    return (np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), share / share.mean(),
            of, list(names))


def logistic(x, y, share, weights):
    t = x @ weights
    slope = x.T @ (share * (1 / (1 + np.exp(-t)) - y)) / len(y)
    return (share * (np.logaddexp(0, t) - y * t)).mean(), slope


def fit_boxes(frames, weights, rounds):
    """The logistic regression, without the queue."""
    free = len(UNARY) + len(PAIR)
    weights = np.r_[weights[:free], 0, 0]
    ridge = 0.02 * np.r_[0, 0.1, np.ones(free - 2)] / free
    for _ in range(rounds):
        x, y, share, _, _ = rows_of(frames, weights)

        def loss(w):
            value, slope = logistic(x[:, :free], y, share, w)
            return value + (ridge * w * w).sum(), slope + 2 * ridge * w

        weights[:free] = minimize(loss, weights[:free], jac=True, method="L-BFGS-B").x
    return weights


def fit_counts(frames, start, rounds, is_queue):
    """The counts of cameras and frames: bias, overlap and queue, held to `start`."""
    weights, free = start.copy(), np.r_[0, len(UNARY):len(start)]
    for _ in range(rounds):
        x, y, share, of, names = rows_of(frames, weights)
        camera = np.array([names.index(f.camera) for f in frames])
        true = np.array([f.vehicles for f in frames], float)
        all_true = np.bincount(camera, true)
        weigh = np.array([STREET_WEIGHT if is_queue(n) else K109F_WEIGHT if n == "k109f" else 1
                          for n in names])
        weigh = weigh / weigh.sum()
        spread = weigh[camera] / np.sqrt(true + 1) / np.bincount(camera)[camera]

        def loss(part):
            w = weights.copy()
            w[free] = part
            value, slope = logistic(x, y, share, w)
            value += RIDGE * ((w - start) ** 2).sum() / len(w)
            counts = 1 / (1 + np.exp(-STEEP * (x @ w)))
            of_frame = np.bincount(of, counts, len(frames))
            bias = np.bincount(camera, of_frame) / all_true - 1
            off = of_frame - true
            length = np.sqrt(off * off + 0.25)
            value += 10 * (weigh * bias * bias).sum() + (spread * length).sum()
            pull = (20 * weigh * bias / all_true)[camera] + spread * off / length
            change = STEEP * counts * (1 - counts) * pull[of]
            return value, (slope + x.T @ change + 2 * RIDGE * (w - start) / len(w))[free]

        weights[free] = minimize(loss, weights[free], jac=True, method="L-BFGS-B",
                                 options={"maxiter": 200}).x
    return weights


def figures(rows, least):
    """Mean of the cameras' absolute biases, error of a frame, light traffic, slope over 12."""
    cameras = {}
    for row in rows:
        cameras.setdefault(row["camera"], []).append((row["true"], row["counts"][least]))
    bias, error = [], []
    for counts in cameras.values():
        true, found = np.array(counts, float).T
        bias.append(abs(found.sum() / true.sum() - 1))
        error.append(np.abs(found - true).mean())
    true, found = np.array([c for counts in cameras.values() for c in counts], float).T
    light, heavy = true <= 3, true > 12
    return (f"mean |bias| {100 * np.mean(bias):.1f} %, error of a frame {np.mean(error):.2f}, "
            f"light traffic {100 * (found[light].sum() / true[light].sum() - 1):+.0f} %, slope "
            f"{(true * found)[heavy].sum() / (true * true)[heavy].sum():.2f}")


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--data", required=True)
    args.add_argument("--street", required=True, help="recordings that street.py has made")
    args.add_argument("--model", default=MODEL, help="the net, ONNX [default: the shipped one]")
    args.add_argument("--columns", type=int,
                      help="of the net's input [default: as the size of cars asks for]")
    args.add_argument("--counts", help="write what each camera counts without a part in the fit")
    args.add_argument("--camera", action="append", help="only these are left out in turn")
    args = args.parse_args()
    pictures, roads = {}, {}
    for picture in data.load_sg_lta(args.data):
        pictures.setdefault((picture.group, picture.night), []).append(picture.path)
    with tempfile.TemporaryDirectory() as work:
        photographs = [*audited(args.data, work)]
        shown = [*committed(args.data)]
        made = [*street(args.street)]
        for key in {(f.camera, f.night) for f in photographs} & pictures.keys():
            roads[key] = field(np.median([grid(path) for path in pictures[key]], axis=0))
        frames = photographs + shown + made
        prepare(frames, args.columns, roads, args.model)
    queues = {f.camera for f in made if f.camera.startswith("curve")} | {"curve"}
    boxes_of = lambda without: [f for f in photographs + shown if f.camera != without
                                and f.camera in (*PHOTOGRAPHS, "k109f", "curve", "freeway")]
    start = np.r_[2.4, 2.3, np.zeros(len(UNARY) - 2), 0, -1.4, -1.4, np.zeros(5)]
    first = fit_boxes(boxes_of(None), start, 3)
    fit = lambda weights, frames, rounds: fit_counts(
        frames, np.r_[weights[:-2], -0.2, 0.4], rounds, lambda name: name in queues)
    weights = fit(first, frames, 2)
    for name, weight in zip(UNARY + PAIR + QUEUE, weights):
        print(f"{name} = {weight:.3f}")
    rows = []
    for camera in args.camera or sorted({f.camera for f in photographs} | {"k109f"}):
        without = fit(fit_boxes(boxes_of(camera), first, 1),
                      [f for f in frames if f.camera != camera], 1)
        for frame in (f for f in photographs + shown if f.camera == camera):
            counts = {str(p): choose(frame, without, least=p)[1] for p in LEAST}
            rows.append({"frame": os.path.basename(frame.path), "camera": camera,
                         "light": frame.light, "role": frame.role, "true": frame.vehicles,
                         "counts": counts})
    if args.counts:
        with open(args.counts, "w") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
    for least in LEAST:
        print(least, figures([r for r in rows if r["camera"] in PHOTOGRAPHS], str(least)))


if __name__ == "__main__":
    main()
