"""Assignment of output rows to vehicles, and the cost of errors.

Dynamic assignment as NanoDet-Plus does it (overlap, score and a soft centre prior), quality
focal loss for the vehicle score, GIoU and distribution focal loss for the box, and a softmax
over the kinds where the kind is known. Rows inside ignored boxes teach nothing.
"""

import torch
import torch.nn.functional as F

from nanodet import BINS

TOP = 13  # rows whose summed overlap sets how many answer for one vehicle
RADIUS = 1.0  # strides around a small vehicle's centre that may answer for it


def boxes_of(logits, grid):
    bins = logits.reshape(*logits.shape[:-1], 4, BINS).softmax(-1)
    d = bins @ torch.arange(BINS, dtype=bins.dtype) * grid[:, 2:3]
    return torch.cat([grid[:, :2] - d[..., :2], grid[:, :2] + d[..., 2:]], -1)


def pair_iou(a, b):
    lt, rb = torch.max(a[:, None, :2], b[None, :, :2]), torch.min(a[:, None, 2:], b[None, :, 2:])
    inter = (rb - lt).clamp(min=0).prod(2)
    area = lambda x: (x[:, 2:] - x[:, :2]).clamp(min=0).prod(1)
    return inter / (area(a)[:, None] + area(b)[None] - inter + 1e-9)


@torch.no_grad()
def assign(score, pred, truth, grid):
    """Index of the vehicle that each row answers for, or -1."""
    owner = torch.full((len(grid),), -1, dtype=torch.long)
    if len(truth) == 0:
        return owner
    x, y, s = grid[:, 0:1], grid[:, 1:2], grid[:, 2:3]
    inside = ((x > truth[:, 0]) & (x < truth[:, 2]) & (y > truth[:, 1]) & (y < truth[:, 3]))
    cx, cy = (truth[:, 0] + truth[:, 2]) / 2, (truth[:, 1] + truth[:, 3]) / 2
    away = torch.hypot(x - cx, y - cy) / s
    small = (truth[:, 2:] - truth[:, :2]).amin(1) < 16
    inside |= small & (away < RADIUS) & (s == 8)
    iou = pair_iou(pred, truth)
    sure = F.binary_cross_entropy_with_logits(
        score[:, None].expand_as(iou), iou, reduction="none") * (score.sigmoid()[:, None] - iou) ** 2
    cost = sure - 3 * torch.log(iou + 1e-7) + 10.0 ** (away - 3)
    cost[~inside] = 1e8
    top = torch.where(inside, iou, torch.zeros_like(iou)).topk(min(TOP, len(grid)), 0).values
    want = top.sum(0).int().clamp(min=1)
    chosen = torch.zeros_like(inside)
    for j in range(len(truth)):
        rows = cost[:, j].topk(int(want[j]), largest=False).indices
        chosen[rows[cost[rows, j] < 1e7], j] = True
    best = torch.where(chosen, cost, torch.full_like(cost, 1e9)).min(1)
    return torch.where(chosen.any(1), best.indices, owner)


def giou_loss(a, b):
    lt, rb = torch.max(a[:, :2], b[:, :2]), torch.min(a[:, 2:], b[:, 2:])
    inter = (rb - lt).clamp(min=0).prod(1)
    area = lambda x: (x[:, 2:] - x[:, :2]).clamp(min=0).prod(1)
    union = area(a) + area(b) - inter + 1e-7
    hull = (torch.max(a[:, 2:], b[:, 2:]) - torch.min(a[:, :2], b[:, :2])).prod(1) + 1e-7
    return 1 - inter / union + (hull - union) / hull


def distribution_loss(logits, target):
    low = target.floor()
    right = target - low
    low = low.long()
    flat, low, right = logits.reshape(-1, BINS), low.reshape(-1), right.reshape(-1)
    loss = (F.cross_entropy(flat, low, reduction="none") * (1 - right)
            + F.cross_entropy(flat, low + 1, reduction="none") * right)
    return loss.reshape(-1, 4).mean(1)


def detection_loss(out, targets, grid, columns):
    """Sum of the terms and the terms. `targets`: (boxes, classes, ignored boxes) a picture."""
    pred = boxes_of(out[..., columns:], grid)
    score_sum = box_sum = bins_sum = kind_sum = out.new_zeros(())
    weight_sum, positives, kinds = 0.0, 0, 0
    for i, (truth, classes, ignored) in enumerate(targets):
        score = out[i, :, 0]
        owner = assign(score.detach(), pred[i].detach(), truth, grid)
        rows = owner >= 0
        quality = torch.zeros_like(score)
        if rows.any():
            goal = truth[owner[rows]]
            got = pred[i][rows]
            quality[rows] = pair_iou(got.detach(), truth)[torch.arange(len(got)), owner[rows]]
            weight = score[rows].detach().sigmoid().clamp(min=0.1)
            weight_sum += float(weight.sum())
            positives += int(rows.sum())
            box_sum = box_sum + (giou_loss(got, goal) * weight).sum()
            at, s = grid[rows, :2], grid[rows, 2:3]
            dist = torch.cat([at - goal[:, :2], goal[:, 2:] - at], 1) / s
            dist = dist.clamp(0, BINS - 1 - 0.1)
            bins = out[i, rows, columns:].reshape(-1, 4, BINS)
            bins_sum = bins_sum + (distribution_loss(bins, dist) * weight).sum()
            kind = classes[owner[rows]]
            if (kind > 0).any():
                kind_sum = kind_sum + F.cross_entropy(
                    out[i, rows, 1:columns][kind > 0], kind[kind > 0] - 1, reduction="sum")
                kinds += int((kind > 0).sum())
        focal = F.binary_cross_entropy_with_logits(score, quality, reduction="none")
        focal = focal * (score.sigmoid() - quality).detach().abs() ** 2
        if len(ignored):
            x, y = grid[:, 0:1], grid[:, 1:2]
            mute = ((x > ignored[:, 0]) & (x < ignored[:, 2])
                    & (y > ignored[:, 1]) & (y < ignored[:, 3])).any(1)
            focal = focal * (rows | ~mute)
        score_sum = score_sum + focal.sum()
    score_loss = score_sum / max(positives, 1)
    box_loss = 2.0 * box_sum / max(weight_sum, 1.0)
    bins_loss = 0.25 * bins_sum / max(weight_sum, 1.0)
    kind_loss = 0.2 * kind_sum / max(kinds, 1)
    total = score_loss + box_loss + bins_loss + kind_loss
    return total, [float(t.detach()) for t in (score_loss, box_loss, bins_loss, kind_loss)]
