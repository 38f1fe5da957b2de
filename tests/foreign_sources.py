"""Arithmetic of OpenPCDet's and mmdetection3d's pillar models, written plainly: loops over points and anchors.

The code is independent of shift3d. Modules are nested so that their state dicts have the codebases' names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import atan2, exp, floor, hypot, pi

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class Pillars:
    """Pillar settings. cap: slots; None: dynamic. legacy: offsets over the coordinates. hard: HardVFE's."""

    bounds: Sequence[float]
    voxel: Sequence[float]
    extras: Sequence[float]
    filters: Sequence[int]
    cap: int | None
    legacy: bool = False
    hard: bool = False


@dataclass(frozen=True)
class Anchors:
    """offset: of the direction bins. starts, steps: of each anchor's x and y; the third of starts: its bottom."""

    classes: int
    vehicle: int
    offset: float
    sizes: Sequence[Sequence[float]]
    starts: Sequence[Sequence[float]]
    steps: Sequence[float]
    code: int = 7
    rotations: Sequence[float] = (0.0, 1.57)


@dataclass(frozen=True)
class Centres:
    """Centre head settings. tasks: classes of each head."""

    tasks: Sequence[int]
    task: int
    vehicle: int
    shared: int
    hidden: int
    biased: bool
    velocity: bool
    stride: int


@dataclass(frozen=True)
class Source:
    """Model of one of the codebases. pcd: True if the codebase is OpenPCDet."""

    pcd: bool
    pillars: Pillars
    strides: Sequence[int]
    ups: Sequence[float]
    head: Anchors | Centres
    prefix: str = ""
    plain_up: bool = False
    model: nn.Module = field(init=False)

    def __post_init__(self) -> None:
        """Draw random weights and varied statistics of norms."""
        torch.manual_seed(3)
        model = nn.Module()
        p = self.prefix
        model.add_module(f"{p}{'vfe' if self.pcd else 'voxel_encoder'}", _encoder(self.pillars))
        channels = self.pillars.filters[-1]
        blocks, ups = _backbone(channels, self.strides, self.pcd), _upsampling(self.ups, self.plain_up)
        if self.pcd:
            model.backbone_2d = nn.Module()
            model.backbone_2d.blocks, model.backbone_2d.deblocks = blocks, ups
            model.register_buffer("global_step", torch.zeros(1, dtype=torch.int64))
        else:
            for name, part, child in (("backbone", blocks, "blocks"), ("neck", ups, "deblocks")):
                holder = nn.Module()
                holder.add_module(child, part)
                model.add_module(p + name, holder)
        heads = (
            _anchor_head(self.head, self.pcd) if isinstance(self.head, Anchors) else _centre_head(self.head, self.pcd)
        )
        model.add_module(f"{p}{'dense_head' if self.pcd else 'bbox_head'}", heads)
        for module in model.modules():
            if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
                nn.init.normal_(module.running_mean, std=0.2)
                nn.init.uniform_(module.running_var, 0.5, 1.5)
                nn.init.normal_(module.bias, std=0.3)
            elif isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.normal_(module.bias, std=0.3)
        for name in ("conv_box", "conv_reg"):
            if hasattr(heads, name):
                getattr(heads, name).weight.data *= 0.3  # sizes of a hundredth to a hundred times an anchor's
        object.__setattr__(self, "model", model.double().eval())

    def part(self, name: str) -> nn.Module:
        """Return a part of the model."""
        return getattr(self.model, self.prefix + name)  # type: ignore[no-any-return]

    def answer(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Compute boxes (A, 7), geometric centres, and vehicle logits (A,) of points (N, 3) in the model's frame."""
        maps = self._features(self._canvas(points))
        if isinstance(self.head, Anchors):
            return self._anchored(maps, self.head)
        return self._centred(maps, self.head)

    def _canvas(self, points: Tensor) -> Tensor:
        lay = self.pillars
        count_x, count_y = (round((lay.bounds[axis + 3] - lay.bounds[axis]) / lay.voxel[axis]) for axis in (0, 1))
        cells: dict[tuple[int, int], list[Tensor]] = {}
        for point in points:
            x, y, z = (float(value) for value in point.detach())
            column, line = floor((x - lay.bounds[0]) / lay.voxel[0]), floor((y - lay.bounds[1]) / lay.voxel[1])
            high = lay.cap is not None and not lay.bounds[2] <= z < lay.bounds[5]
            if 0 <= column < count_x and 0 <= line < count_y and not high:
                cells.setdefault((line, column), []).append(point)
        canvas = points.new_zeros(lay.filters[-1], count_y, count_x)
        for (line, column), members in cells.items():
            feature = self._pillar(torch.stack(members), column, line)
            place = torch.zeros_like(canvas)
            place[:, line, column] = 1.0
            canvas = canvas + place * feature[:, None, None]
        return canvas[None]

    def _pillar(self, xyz: Tensor, column: int, line: int) -> Tensor:
        lay = self.pillars
        middle = [
            column * lay.voxel[0] + lay.voxel[0] / 2 + lay.bounds[0],
            line * lay.voxel[1] + lay.voxel[1] / 2 + lay.bounds[1],
            lay.voxel[2] / 2 + lay.bounds[2],
        ]
        mean = xyz.sum(0) / len(xyz)
        rows = []
        for point in xyz:
            to_middle = point - point.new_tensor(middle)
            rows.append(
                torch.cat((to_middle if lay.legacy else point, point.new_tensor(lay.extras), point - mean, to_middle))
            )
        if lay.cap is not None:
            rows += [torch.zeros_like(rows[0])] * (lay.cap - len(rows))
        values = torch.stack(rows)
        part = self.part("vfe" if self.pcd else "voxel_encoder")
        layers = part.vfe_layers if lay.hard else part.pfn_layers
        for index, layer in enumerate(layers):
            values = torch.relu(layer.norm(layer.linear(values)))
            best = values.max(dim=0).values
            if index + 1 < len(layers):
                values = torch.cat((values, best.expand(len(values), -1)), dim=1)
        return best

    def _features(self, canvas: Tensor) -> Tensor:
        if self.pcd:
            blocks, ups = self.model.backbone_2d.blocks, self.model.backbone_2d.deblocks
        else:
            blocks, ups = self.part("backbone").blocks, self.part("neck").deblocks
        outputs, features = [], canvas
        for block, up in zip(blocks, ups, strict=True):
            features = block(features)
            outputs.append(up(features))
        return torch.cat(outputs, dim=1)

    def _anchored(self, features: Tensor, head: Anchors) -> tuple[Tensor, Tensor]:
        part = self.part("dense_head" if self.pcd else "bbox_head")
        names = ("conv_cls", "conv_box" if self.pcd else "conv_reg", "conv_dir_cls")
        classes, codes, directions = (getattr(part, name)(features)[0].permute(1, 2, 0) for name in names)
        codes, boxes, logits = codes.detach(), [], []
        for line in range(features.shape[2]):
            for column in range(features.shape[3]):
                number = 0
                for size, start in zip(head.sizes, head.starts, strict=True):
                    for rotation in head.rotations:
                        at = (start[0] + column * head.steps[0], start[1] + line * head.steps[1], start[2])
                        code = codes[line, column, head.code * number : head.code * number + 7].tolist()
                        pair = directions[line, column, 2 * number : 2 * number + 2]
                        boxes.append(_decoded(at, size, rotation, code, int(pair.argmax()), head.offset))
                        logits.append(classes[line, column, number * head.classes + head.vehicle])
                        number += 1
        return torch.tensor(boxes, dtype=torch.float64), torch.stack(logits)

    def _centred(self, features: Tensor, head: Centres) -> tuple[Tensor, Tensor]:
        part = self.part("dense_head" if self.pcd else "bbox_head")
        shared = part.shared_conv(features)
        tower = (part.heads_list if self.pcd else part.task_heads)[head.task]
        names = ("center", "center_z", "dim", "rot", "hm") if self.pcd else ("reg", "height", "dim", "rot", "heatmap")
        *drawn, heat = (getattr(tower, name)(shared)[0] for name in names)
        offset, height, size, turn = (part.detach() for part in drawn)
        boxes, logits, step = [], [], [head.stride * side for side in self.pillars.voxel]
        for line in range(features.shape[2]):
            for column in range(features.shape[3]):
                first, second = turn[:, line, column].tolist()
                heading = atan2(second, first) if self.pcd else atan2(first, second)
                x = (column + float(offset[0, line, column])) * step[0] + self.pillars.bounds[0]
                y = (line + float(offset[1, line, column])) * step[1] + self.pillars.bounds[1]
                sizes = [exp(value) for value in size[:, line, column].tolist()]
                boxes.append((x, y, float(height[0, line, column]), *sizes, heading))
                logits.append(heat[head.vehicle, line, column])
        return torch.tensor(boxes, dtype=torch.float64), torch.stack(logits)


def _decoded(
    at: Sequence[float], size: Sequence[float], rotation: float, code: Sequence[float], direction: int, offset: float
) -> tuple[float, ...]:
    """Decode a box from an anchor on its bottom and a code. Both codebases decode heights between geometric centres."""
    diagonal, middle = hypot(size[0], size[1]), at[2] + size[2] / 2
    heading = code[6] + rotation - offset
    heading = heading - floor(heading / pi) * pi + offset + pi * direction
    return (
        code[0] * diagonal + at[0], code[1] * diagonal + at[1], code[2] * size[2] + middle,
        exp(code[3]) * size[0], exp(code[4]) * size[1], exp(code[5]) * size[2], heading,
    )  # fmt: skip


def _encoder(lay: Pillars) -> nn.Module:
    module, inputs = nn.Module(), 3 + len(lay.extras) + 6
    layers = nn.ModuleList()
    module.add_module("vfe_layers" if lay.hard else "pfn_layers", layers)
    for index, width in enumerate(lay.filters):
        width = width if index + 1 == len(lay.filters) or lay.hard else width // 2
        layer = nn.Module()
        layer.linear, layer.norm = nn.Linear(inputs, width, bias=False), nn.BatchNorm1d(width, eps=1e-3)
        layers.append(layer)
        inputs = 2 * width
    return module


def _backbone(channels: int, strides: Sequence[int], padded: bool) -> nn.ModuleList:
    blocks = nn.ModuleList()
    for stride in strides:
        first = [nn.ZeroPad2d(1), nn.Conv2d(channels, 8, 3, stride, bias=False)] if padded else [
            nn.Conv2d(channels, 8, 3, stride, padding=1, bias=False)
        ]  # fmt: skip
        second = nn.Conv2d(8, 8, 3, padding=1, bias=False)
        norms = [nn.BatchNorm2d(8, eps=1e-3) for _ in range(2)]
        blocks.append(nn.Sequential(*first, norms[0], nn.ReLU(), second, norms[1], nn.ReLU()))
        channels = 8
    return blocks


def _upsampling(ups: Sequence[float], plain: bool) -> nn.ModuleList:
    result = nn.ModuleList()
    for up in ups:
        if up > 1 or (up == 1 and not plain):
            layer: nn.Module = nn.ConvTranspose2d(8, 8, int(up), int(up), bias=False)
        else:
            layer = nn.Conv2d(8, 8, round(1 / up), round(1 / up), bias=False)
        result.append(nn.Sequential(layer, nn.BatchNorm2d(8, eps=1e-3), nn.ReLU()))
    return result


def _anchor_head(head: Anchors, pcd: bool) -> nn.Module:
    part, count = nn.Module(), len(head.sizes) * len(head.rotations)
    part.conv_cls = nn.Conv2d(24, count * head.classes, 1)
    part.add_module("conv_box" if pcd else "conv_reg", nn.Conv2d(24, count * head.code, 1))
    part.conv_dir_cls = nn.Conv2d(24, count * 2, 1)
    return part


def _unit(inputs: int, outputs: int, biased: bool, pcd: bool) -> nn.Module:
    parts = (nn.Conv2d(inputs, outputs, 3, padding=1, bias=biased), nn.BatchNorm2d(outputs))
    if pcd:
        return nn.Sequential(*parts, nn.ReLU())
    unit = nn.Sequential()
    for name, module in zip(("conv", "bn", "activate"), (*parts, nn.ReLU()), strict=True):
        unit.add_module(name, module)
    return unit


def _centre_head(head: Centres, pcd: bool) -> nn.Module:
    part = nn.Module()
    part.shared_conv = _unit(24, head.shared, head.biased, pcd)
    towers = nn.ModuleList()
    names = ("center", "center_z", "dim", "rot") if pcd else ("reg", "height", "dim", "rot")
    for classes in head.tasks:
        tower = nn.Module()
        outputs = dict(zip(names, (2, 1, 3, 2), strict=True)) | {"hm" if pcd else "heatmap": classes}
        for name, width in (outputs | ({"vel": 2} if head.velocity else {})).items():
            unit = _unit(head.shared, head.hidden, head.biased, pcd)
            tower.add_module(name, nn.Sequential(unit, nn.Conv2d(head.hidden, width, 3, padding=1)))
        towers.append(tower)
    part.add_module("heads_list" if pcd else "task_heads", towers)
    return part
