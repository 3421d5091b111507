"""NanoDet-Plus-m with batch norm folded in: modules, and the COCO weights carried into them.

Convolutions run in the order in which the exported COCO graph lists them, so its weights
load by position. Owns the six score columns of our head; see `Scores`.
"""

import numpy as np
import onnx
import torch
import torch.nn.functional as F
from onnx import numpy_helper
from torch import nn

from data import CLASSES

BINS = 8
# COCO rows that start our columns: vehicle, car, van, bus, truck, motorcycle.
COCO_START = [[2], [2], [2, 7], [5], [7], [3]]


def conv(cin, cout, kernel, stride=1, groups=1, act=True):
    layer = nn.Conv2d(cin, cout, kernel, stride, kernel // 2, groups=groups)
    return nn.Sequential(layer, nn.LeakyReLU(0.1, inplace=True)) if act else nn.Sequential(layer)


def shuffle(x):
    b, c, h, w = x.shape
    return x.view(b, 2, c // 2, h, w).transpose(1, 2).reshape(b, c, h, w)


class Unit(nn.Module):
    """ShuffleNetV2 unit."""

    def __init__(self, cin, cout, stride):
        super().__init__()
        half = cout // 2
        self.stride = stride
        if stride == 2:
            self.left = nn.Sequential(conv(cin, cin, 3, 2, cin, False), conv(cin, half, 1))
        right = cin if stride == 2 else half
        self.right = nn.Sequential(conv(right, half, 1), conv(half, half, 3, stride, half, False),
                                   conv(half, half, 1))

    def forward(self, x):
        left, right = (self.left(x), x) if self.stride == 2 else x.chunk(2, 1)
        return shuffle(torch.cat([left, self.right(right)], 1))


class Ghost(nn.Module):
    """Half of the channels by a 1x1 convolution, the other half cheaply from them."""

    def __init__(self, cin, cout, act):
        super().__init__()
        half = cout // 2
        self.primary = conv(cin, half, 1, act=act)
        self.cheap = conv(half, half, 3, groups=half, act=act)

    def forward(self, x):
        x = self.primary(x)
        return torch.cat([x, self.cheap(x)], 1)


class GhostBlock(nn.Module):
    def __init__(self, cin, cout):
        super().__init__()
        self.main = nn.Sequential(Ghost(cin, cout, True), Ghost(cout, cout, False))
        self.short = nn.Sequential(conv(cin, cin, 5, groups=cin, act=False),
                                   conv(cin, cout, 1, act=False))

    def forward(self, x):
        return self.main(x) + self.short(x)


def separable(channels, stride=1):
    return nn.Sequential(conv(channels, channels, 5, stride, channels), conv(channels, channels, 1))


def twice(x):
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


class NanoDet(nn.Module):
    """`forward` gives logits: [batch, rows, columns + 4 * BINS]."""

    def __init__(self, columns=len(CLASSES), width=96):
        super().__init__()
        self.columns, self.frozen = columns, 0
        self.stem = conv(3, 24, 3, 2)
        stages, cin = [], 24
        for cout, repeat in ((116, 4), (232, 8), (464, 4)):
            units = [Unit(cin, cout, 2)] + [Unit(cout, cout, 1) for _ in range(repeat - 1)]
            stages.append(nn.Sequential(*units))
            cin = cout
        self.stages = nn.ModuleList(stages)
        self.reduce = nn.ModuleList([conv(c, width, 1) for c in (116, 232, 464)])
        self.top_down = nn.ModuleList([GhostBlock(2 * width, width) for _ in range(2)])
        self.bottom_up = nn.ModuleList([
            nn.ModuleList([separable(width, 2), GhostBlock(2 * width, width)]) for _ in range(2)])
        self.extra = nn.ModuleList([separable(width, 2), separable(width, 2)])
        self.head = nn.ModuleList([
            nn.Sequential(separable(width), separable(width),
                          nn.Conv2d(width, columns + 4 * BINS, 1)) for _ in range(4)])

    def freeze(self, stages):
        """Keep the stem and the first stages as they are: half of the work, their edges serve."""
        self.frozen = stages
        for m in [self.stem, *self.stages[:stages]]:
            m.requires_grad_(False)

    def levels(self, x):
        with torch.set_grad_enabled(torch.is_grad_enabled() and self.frozen == 0):
            x = F.max_pool2d(self.stem(x), 3, 2, 1)
        found = []
        for i, stage in enumerate(self.stages):
            with torch.set_grad_enabled(torch.is_grad_enabled() and i >= self.frozen):
                x = stage(x)
            found.append(x)
        c3, c4, c5 = (layer(f) for layer, f in zip(self.reduce, found))
        p4 = self.top_down[0](torch.cat([twice(c5), c4], 1))
        p3 = self.top_down[1](torch.cat([twice(p4), c3], 1))
        n4 = self.bottom_up[0][1](torch.cat([self.bottom_up[0][0](p3), p4], 1))
        n5 = self.bottom_up[1][1](torch.cat([self.bottom_up[1][0](n4), c5], 1))
        n6 = self.extra[0](c5) + self.extra[1](n5)
        return [h(f) for h, f in zip(self.head, (p3, n4, n5, n6))]

    def forward(self, x):
        return torch.cat([f.flatten(2) for f in self.levels(x)], 2).transpose(1, 2)


class Scores(nn.Module):
    """The exported network: logits to scores.

    Column 0 (`vehicle`) is trained on every data set and ranks the boxes. The five kinds are
    a softmax that only names the box. Out go the five kinds, scaled so that the largest of
    them equals the vehicle score: the best column ranks as column 0 would.
    """

    def __init__(self, net):
        super().__init__()
        self.net = net

    def forward(self, data):
        out = self.net(data)
        kinds = out[..., 1:self.net.columns]
        share = torch.exp(kinds - kinds.amax(2, keepdim=True))
        scores = torch.sigmoid(out[..., :1]) * share
        return torch.cat([scores, out[..., self.net.columns:]], 2)


def convolutions(net, x):
    """Convolutions in the order of execution."""
    order, hooks = [], []
    for m in net.modules():
        if isinstance(m, nn.Conv2d):
            hooks.append(m.register_forward_hook(lambda m, i, o: order.append(m)))
    with torch.no_grad():
        net(x)
    for h in hooks:
        h.remove()
    return order


def carry(net, path):
    """Weights of an exported network: COCO's NanoDet-Plus-m, or one that `export.py` wrote.

    From COCO's head our columns start as related rows.
    """
    graph = onnx.load(path).graph
    values = {i.name: numpy_helper.to_array(i) for i in graph.initializer}
    for name in [n[: -len(".int8")] for n in values if n.endswith(".int8")]:
        values[name] = values[name + ".int8"] * values[name + ".scale"]
    for n in graph.node:
        if n.op_type == "DequantizeLinear" and n.input[0] in values:
            steps, scale = values[n.input[0]].astype(np.float32), values[n.input[1]]
            values[n.output[0]] = steps * scale.reshape((-1,) + (1,) * (steps.ndim - 1))
    nodes = [n for n in graph.node if n.op_type == "Conv"]
    layers = convolutions(net, torch.zeros(1, 3, 64, 64))
    if len(nodes) != len(layers):
        raise ValueError(f"{path}: {len(nodes)} convolutions, this network has {len(layers)}")
    for node, layer in zip(nodes, layers):
        weight = torch.from_numpy(values[node.input[1]].copy())
        bias = torch.from_numpy(values[node.input[2]].copy())
        if weight.shape != layer.weight.shape and weight.shape[0] == 80 + 4 * BINS:
            rows = [weight[r].mean(0, keepdim=True) for r in COCO_START]
            starts = [bias[r].mean(0, keepdim=True) for r in COCO_START]
            weight, bias = torch.cat(rows + [weight[80:]]), torch.cat(starts + [bias[80:]])
        if weight.shape != layer.weight.shape:
            raise ValueError(f"{path}: {node.name} is {tuple(weight.shape)}, "
                             f"here {tuple(layer.weight.shape)}")
        layer.weight.data.copy_(weight)
        layer.bias.data.copy_(bias)

