"""Average the weights of two runs, the second of which went on from the first.

    python3 detector/train/average.py --first A.pt --second B.pt --share 0.75 --out C.pt

What the second run learnt stays for the most part, and of what it forgot much comes back
(Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022).
"""

import argparse

import torch

from nanodet import NanoDet, carry


def read(path):
    """A checkpoint of `train.py`, or an exported net as one."""
    if not path.endswith(".onnx"):
        return torch.load(path, map_location="cpu", weights_only=False)
    net = NanoDet()
    carry(net, path)
    return {"mean": net.state_dict(), "step": "the exported net"}


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--first", required=True, help="a checkpoint of train.py, or a net, ONNX")
    args.add_argument("--second", required=True)
    args.add_argument("--share", type=float, default=0.75, help="of the second, 0 to 1")
    args.add_argument("--out", required=True)
    args = args.parse_args()
    first, second = read(args.first), read(args.second)
    for name, value in second["mean"].items():
        if value.is_floating_point():
            value.lerp_(first["mean"][name], 1 - args.share)
    second["step"] = f"{first['step']} and {second['step']} averaged"
    torch.save(second, args.out)


if __name__ == "__main__":
    main()
