"""How often the interval of a count holds what people count, with and without an audit of the camera.

    python3 detector/train/coverage.py [--counts FILE] [--least 0.5]

Owns the check only. `detector/data/counts.jsonl` is what `evidence.py --counts` writes: what each
camera counts with weights that were fitted without it. A camera-window is all of a camera's audited
frames in one light. True and counted are means over the same frames, so that sampling has no part in
their difference: the test is of counting's part of the interval. The interval that a density of so few
frames has, with sampling, is counted beside it. Without an audit the spread comes from the other
cameras (one standard error: root of the sum of the squares of a part of the count and of a number of
vehicles), so that no camera judges itself. With one, the camera's `audit` frames give score and factors
as `src/daemon/audit/fit.rs` has it, written once more here, and the `check` frames are the window.
"""

import argparse
import json
import os

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
COUNTS = os.path.join(HERE, "..", "data", "counts.jsonl")
Z90 = 1.645
STUDENT = [3.84, 1.78, 1.43, 1.30, 1.23, 1.18, 1.15, 1.13, 1.11, 1.10, 1.09, 1.08]
DOUBT, LOADS, OF_A_LOAD = 0.1, 3, 3
FEWEST = 3  # frames of a window
FRAMES = 10  # of an audit, as `verge audit` asks for


def windows(rows, role=None):
    """Camera, light, true and counted (rows by score) of each window."""
    groups = {}
    for row in rows:
        if role in (None, row["role"]):
            groups.setdefault((row["camera"], "day" if row["light"] == "day" else "night"), []).append(row)
    return {key: group for key, group in groups.items() if len(group) >= FEWEST}


def means(group, least):
    return (np.mean([r["true"] for r in group]), np.mean([r["counts"][least] for r in group]))


def spread(pairs):
    """The part and the number by which counts of cameras differ, likeliest for normal errors."""
    true, counted = np.array(pairs).T
    off = (counted - true) ** 2
    best = None
    for part in np.arange(0.02, 0.4, 0.01):
        for vehicles in np.arange(0.05, 1.5, 0.05):
            variance = (part * counted) ** 2 + vehicles ** 2
            cost = (np.log(variance) + off / variance).sum()
            if best is None or cost < best[0]:
                best = cost, part, vehicles
    # A new camera is one more of few: Student's quantile, and the doubt of the spread itself.
    few = STUDENT[min(len(pairs) - 2, len(STUDENT) - 1)] * np.sqrt(1 + 1 / len(pairs))
    return few * best[1], few * best[2]


def sampling(counts):
    """Standard error of a mean of frames far apart, as `Series::mean_and_error` has it."""
    counts = np.array(counts, float)
    squares = ((counts - counts.mean()) ** 2).sum()
    return np.sqrt((squares + counts.mean() + 0.5) / len(counts) / len(counts))


def audit(frames, stated, part, vehicles):
    """Score, loads and the remaining error: `fit` of the daemon."""
    true = np.array([f["true"] for f in frames], float)
    counts = {s: np.array([f["counts"][s] for f in frames], float) for s in frames[0]["counts"]}
    n = len(frames)
    cost = {s: n * np.log(((true - c) ** 2).mean() + 0.25) + (s != stated) * np.log(n)
            for s, c in counts.items()}
    score = min(cost, key=lambda s: (cost[s], s != stated))
    found = counts[score]
    order = np.argsort(found, kind="stable")
    parts = int(np.clip(n // OF_A_LOAD, 1, LOADS))
    loads = [order[p * n // parts:(p + 1) * n // parts] for p in range(parts)]
    ratio = [true[q].sum() / found[q].sum() if found[q].sum() else 1 for q in loads]
    squares = sum(((true[q] - r * found[q]) ** 2 / (found[q] + 1)).sum() for q, r in zip(loads, ratio))
    freedom = 1 + n - parts
    dispersion = (squares + DOUBT) / freedom
    wider = STUDENT[freedom - 1] if freedom <= len(STUDENT) else 1 + 1 / freedom
    biases = []
    for q, r in zip(loads, ratio):
        line = found[q].sum()
        if line == 0 or (biases and found[q].mean() <= biases[-1][0]):
            continue
        known = (line / wider) ** 2 / (dispersion * (line + len(q)))
        prior = 1 / part ** 2
        biases.append((found[q].mean(), (known * r + prior) / (known + prior), (known + prior) ** -0.5))
    known = n / (dispersion * (found + 1).mean() * wider ** 2)
    return score, biases, (1 / vehicles ** 2 + known) ** -0.5


def factor(biases, counted):
    if not biases:
        return 1.0, None
    loads, factors, errors = np.array(biases).T
    return np.interp(counted, loads, factors), np.interp(counted, loads, errors)


def test(name, true, counted, counting, sampled):
    """Whether the interval holds the truth, by counting's error alone and with that of sampling."""
    off, whole = abs(true - counted), np.hypot(counting, sampled)
    held = off <= Z90 * counting, off <= Z90 * whole
    print(f"{name}: {true:6.2f} true, {counted:6.2f} +- {Z90 * counting:.2f}, with sampling "
          f"{Z90 * whole:.2f}{'' if held[0] else '  outside'}")
    return held


def summary(tested):
    alone, whole = np.sum(tested, 0)
    return (f"{alone} of {len(tested)} camera-windows by counting alone, {100 * alone / len(tested):.0f} %; "
            f"{whole} with sampling")


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--counts", default=COUNTS)
    args.add_argument("--least", default="0.5", help="least probability of the model")
    args = args.parse_args()
    with open(args.counts) as file:
        rows = [json.loads(line) for line in file]
    every = windows(rows)
    tested, spreads = [], {}
    for light in ("day", "night"):
        pairs = [means(g, args.least) for (_, of), g in every.items() if of == light]
        print(f"{light}: spread over {len(pairs)} cameras: part {spread(pairs)[0]:.2f}, "
              f"vehicles {spread(pairs)[1]:.2f}")
    for (camera, light), group in every.items():
        others = [means(g, args.least) for (c, of), g in every.items() if c != camera and of == light]
        part, vehicles = spread(others)
        spreads[camera, light] = part, vehicles
        true, counted = means(group, args.least)
        tested.append(test(f"{camera:<11}{light:<6}{len(group):>3} frames", true, counted,
                           np.hypot(part * counted, vehicles),
                           sampling([r["counts"][args.least] for r in group])))
    print(f"without an audit: {summary(tested)}")
    tested, biases, audited = [], {}, {}
    for (camera, light), group in windows(rows, "check").items():
        counted_by_eye = [r for r in rows if r["camera"] == camera and r["role"] == "audit"]
        if len(counted_by_eye) < FEWEST:
            continue
        part, vehicles = spreads.get((camera, light), (0.14, 0.4))
        score, loads, left = audit(counted_by_eye, args.least, part, vehicles)
        true, counted = means(group, score)
        times, error = factor(loads, counted)
        error = part * counted if error is None else counted * error
        tested.append(test(f"{camera:<11}{light:<6}{len(group):>3} frames, score {score}", true,
                           times * counted, np.hypot(error, left),
                           times * sampling([r["counts"][score] for r in group])))
        sums = biases.setdefault(camera, np.zeros(2))
        sums += len(group) * np.array([true, times * counted])
        audited[camera] = len(counted_by_eye)
    off = {camera: abs(found / true - 1) for camera, (true, found) in biases.items()}
    full = [off[camera] for camera in off if audited[camera] >= FRAMES]
    print(f"after an audit: {summary(tested)}")
    print(f"mean |camera bias| {100 * np.mean(full):.1f} % over {len(full)} cameras with {FRAMES} audited "
          f"frames, {100 * np.mean([*off.values()]):.1f} % over all {len(off)}")


if __name__ == "__main__":
    main()
