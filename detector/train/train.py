"""Train the detector: one command, seeded, resumable, on a CPU or a GPU.

    python3 detector/train/train.py --data DIR --coco FILE --out DIR [--teacher FILE]

Starts from the COCO NanoDet-Plus-m weights, writes `last.pt` every few minutes (weights,
averaged weights, optimiser, step) and `log.jsonl`. Started again with the same --out it goes on.
"""

import argparse
import json
import os
import pickle
import time

import numpy as np
import torch

import augment
import boxes as geometry
import data
import paste
from loss import detection_loss
from nanodet import NanoDet, carry

WIDTH, HEIGHT = 416, 320


class Windows(torch.utils.data.Dataset):
    """Endless windows; window n depends on the seed and n alone."""

    def __init__(self, pictures, weights, recipe, seed, first, count):
        self.pictures, self.weights, self.recipe = pictures, weights, recipe
        self.seed, self.first, self.count = seed, first, count

    def __len__(self):
        return self.count

    def __getitem__(self, n):
        rng = np.random.default_rng([self.seed, self.first + n])
        index = int(rng.choice(len(self.pictures), p=self.weights))
        img, truth, kinds, ignored = augment.sample(self.pictures, index, rng, WIDTH, HEIGHT,
                                                     self.recipe)
        return (torch.from_numpy(geometry.blob(img)[0]), torch.from_numpy(truth).float(),
                torch.from_numpy(kinds), torch.from_numpy(ignored).float())


def collate(rows):
    return torch.stack([r[0] for r in rows]), [r[1:] for r in rows]


def chances(pictures, mix, unbalanced=False):
    """How often each picture is drawn. `mix`: lines `dataset day|night share`, else balanced."""
    if unbalanced:
        return np.full(len(pictures), 1 / len(pictures))
    cells = {}
    for i, p in enumerate(pictures):
        cells.setdefault((p.dataset, p.night), []).append(i)
    chance = np.zeros(len(pictures))
    for cell, members in cells.items():
        share = mix.get(cell, 0.0) if mix else len(members) ** 0.6
        # Pictures with more labels teach more; a camera with few must not vanish.
        weight = np.array([(1 + len(pictures[i].boxes)) ** 0.5 for i in members])
        chance[members] = share * weight / weight.sum()
    return chance / chance.sum()


def read_mix(path):
    mix = {}
    if path:
        for line in open(path):
            name, light, share = line.split()
            mix[(name, light == "night")] = float(share)
    return mix


def rate(step, args, started):
    """Warm-up, then cosine over steps, or over the time limit when that comes first."""
    done = step / args.steps
    if args.until:
        done = max(done, (time.time() - started) / max(args.until - started, 1.0))
    warm = min(1.0, (step + 1) / args.warmup)
    return float(warm * (0.03 + 0.97 * 0.5 * (1 + np.cos(np.pi * min(done, 1.0))))), done


def save(path, state):
    torch.save(state, path + ".part")
    os.replace(path + ".part", path)


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--data", required=True)
    args.add_argument("--coco", required=True,
                      help="weights to start from: COCO NanoDet-Plus-m, or a model of ours, ONNX")
    args.add_argument("--out", required=True)
    args.add_argument("--street", help="recordings made by street.py: simulated, marked as such")
    args.add_argument("--teacher")
    args.add_argument("--mix", help="shares by data set and light, from `verge-detector mix`")
    args.add_argument("--only", help="train on this data set alone")
    args.add_argument("--unbalanced", action="store_true",
                      help="every picture as often as every other (the paper's Spaghetti)")
    args.add_argument("--zoom", type=float, default=1.7, help="largest, of the 640x480 letterbox")
    args.add_argument("--crowd", type=float, default=0.0,
                      help="chance that vehicles of the same camera are pasted into a picture")
    args.add_argument("--marks", type=float, default=0.0,
                      help="chance of paint, burnt-in words and shadows in a window")
    args.add_argument("--steps", type=int, default=6000)
    args.add_argument("--batch", type=int, default=8)
    args.add_argument("--lr", type=float, default=4e-4)
    args.add_argument("--freeze", type=int, default=0, help="first stages that stay as they are")
    args.add_argument("--bfloat16", action="store_true", help="autocast, where it is faster")
    args.add_argument("--warmup", type=int, default=60)
    args.add_argument("--seed", type=int, default=20210320)
    args.add_argument("--until", type=float, help="Unix time at which the rate has reached its end")
    args.add_argument("--threads", type=int, default=2)
    args.add_argument("--save-every-s", type=float, default=120)
    args = args.parse_args()

    torch.manual_seed(args.seed)
    torch.set_num_threads(args.threads)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    os.makedirs(args.out, exist_ok=True)
    pictures = data.load_all(args.data) + (data.load_street(args.street) if args.street else [])
    pictures = [p for p in pictures if p.split == "train" and args.only in (None, p.dataset)]
    if args.teacher:
        with open(args.teacher, "rb") as file:
            found = pickle.load(file)
        for p in pictures:
            p.teacher = found.get(p.path, p.teacher)
    net = NanoDet()
    carry(net, args.coco)
    net.freeze(args.freeze)
    net = net.to(device).to(memory_format=torch.channels_last).train()
    head = [p for h in net.head for p in h[2].parameters()]
    chosen = {id(p) for p in head}
    rest = [p for p in net.parameters() if id(p) not in chosen and p.requires_grad]
    optimiser = torch.optim.AdamW([{"params": rest, "base": args.lr},
                                   {"params": head, "base": args.lr * 3}], weight_decay=1e-3)
    mean = {k: v.detach().clone() for k, v in net.state_dict().items()}
    step, started, last = 0, time.time(), os.path.join(args.out, "last.pt")
    if os.path.exists(last):
        state = torch.load(last, map_location=device, weights_only=False)
        net.load_state_dict(state["net"])
        mean, step = state["mean"], state["step"]
        optimiser.load_state_dict(state["optimiser"])
        started = state.get("started", started)
    grid = torch.from_numpy(geometry.centres(WIDTH, HEIGHT)).to(device)
    recipe = augment.Recipe((0.6, args.zoom), args.crowd, args.marks,
                            paste.Stock(pictures) if args.crowd else None)
    windows = Windows(pictures, chances(pictures, read_mix(args.mix), args.unbalanced), recipe,
                      args.seed, step * args.batch, (args.steps - step) * args.batch)
    loader = torch.utils.data.DataLoader(windows, args.batch, num_workers=1, collate_fn=collate,
                                         prefetch_factor=4)
    if recipe.stock:
        print(f"{len(recipe.stock)} vehicles cut out", flush=True)
    print(f"{len(pictures)} pictures, from step {step}, {device}", flush=True)
    log, saved, sums, seen = open(os.path.join(args.out, "log.jsonl"), "a"), time.time(), 0, 0
    for blobs, targets in loader:
        factor, done = rate(step, args, started)
        if done >= 1.0:
            break
        for group in optimiser.param_groups:
            group["lr"] = group["base"] * factor
        blobs = blobs.to(device, memory_format=torch.channels_last)
        with torch.autocast(device, torch.bfloat16, enabled=args.bfloat16):
            out = net(blobs)
        targets = [[t.to(device) for t in row] for row in targets]
        total, terms = detection_loss(out.float(), targets, grid, net.columns)
        optimiser.zero_grad(set_to_none=True)
        total.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 10.0)
        optimiser.step()
        step += 1
        keep = min(0.998, step / (step + 20.0))
        with torch.no_grad():
            for k, v in net.state_dict().items():
                mean[k].lerp_(v, 1 - keep)
        sums, seen = sums + np.array(terms), seen + 1
        if seen == 25:
            row = {"step": step, "lr": args.lr * factor, "done": round(done, 4),
                   "s": round(time.time() - started, 1),
                   "score_box_bins_kind": [round(float(v), 4) for v in sums / seen]}
            print(json.dumps(row), flush=True)
            log.write(json.dumps(row) + "\n")
            log.flush()
            sums, seen = 0, 0
        if time.time() - saved > args.save_every_s:
            save(last, {"net": net.state_dict(), "mean": mean, "step": step, "args": vars(args),
                        "optimiser": optimiser.state_dict(), "started": started})
            saved = time.time()
    save(last, {"net": net.state_dict(), "mean": mean, "step": step, "args": vars(args),
                "optimiser": optimiser.state_dict(), "started": started})
    print(f"done at step {step}", flush=True)


if __name__ == "__main__":
    main()
