"""Names and shapes of a model's tensors in its codebase, and the matching parameter names of `ForeignNet`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from torch import Tensor

from shift3d.detectors.foreign.layout import AnchorHead, Branch, CentreHead, Layout

Shape = tuple[int, ...]
_NORM = ("weight", "bias", "running_mean", "running_var")


@dataclass(frozen=True)
class Entry:
    """Tensor of the source. target: parameter of `ForeignNet`, None: not needed. pick: selects the part to copy."""

    name: str
    shape: Shape
    target: str | None
    pick: Callable[[Tensor], Tensor] | None = None


@dataclass(frozen=True)
class _Names:
    """Module names of a codebase. padded: each block starts with a module that has no tensor."""

    encoder: str
    blocks: str
    ups: str
    heads: str
    boxes: str
    shared: tuple[str, str]
    tasks: str
    stacked: tuple[str, str]
    padded: bool


_OPENPCDET = _Names(
    "vfe", "backbone_2d.blocks", "backbone_2d.deblocks", "dense_head", "conv_box", ("0", "1"), "heads_list",
    ("0", "1"), True,
)  # fmt: skip
_MMDET3D = _Names(
    "voxel_encoder", "backbone.blocks", "neck.deblocks", "bbox_head", "conv_reg", ("conv", "bn"), "task_heads",
    ("conv", "bn"), False,
)  # fmt: skip


def entries(layout: Layout) -> Iterator[Entry]:
    """Yield every tensor of the model, except the counters of norms."""
    names, prefix = (_OPENPCDET, "") if layout.source == "openpcdet" else (_MMDET3D, layout.prefix)
    yield from _encoder(layout, prefix + names.encoder)
    yield from _blocks(layout, names, prefix)
    yield from _ups(layout, prefix + names.ups)
    channels = layout.backbone.up_channels * len(layout.backbone.strides)
    if isinstance(layout.head, AnchorHead):
        yield from _anchor_head(layout.head, channels, names, prefix + names.heads)
    else:
        yield from _centre_head(layout.head, channels, names, prefix + names.heads)


def _norm(name: str, channels: int, target: str) -> Iterator[Entry]:
    for part in _NORM:
        yield Entry(f"{name}.{part}", (channels,), f"{target}.{part}")


def _encoder(layout: Layout, name: str) -> Iterator[Entry]:
    filters = layout.inputs.filters
    sources = (layout.inputs.columns, *filters[:-1])
    for index, (source, width) in enumerate(zip(sources, filters, strict=True)):
        outputs = width if index + 1 == len(filters) else width // 2
        layer = f"{name}.{layout.inputs.named}.{index}"
        yield Entry(f"{layer}.linear.weight", (outputs, source), f"pillar_net.linears.{index}.weight")
        yield from _norm(f"{layer}.norm", outputs, f"pillar_net.norms.{index}")


def _blocks(layout: Layout, names: _Names, prefix: str) -> Iterator[Entry]:
    spec = layout.backbone
    sources = (spec.in_channels, *spec.channels[:-1])
    for block, (source, width, layers) in enumerate(zip(sources, spec.channels, spec.layers, strict=True)):
        for layer in range(layers + 1):
            there = f"{prefix}{names.blocks}.{block}"
            number, first = 3 * layer + names.padded, source if layer == 0 else width
            here = f"backbone.blocks.{block}"
            yield Entry(f"{there}.{number}.weight", (width, first, 3, 3), f"{here}.{3 * layer}.weight")
            yield from _norm(f"{there}.{number + 1}", width, f"{here}.{3 * layer + 1}")


def _ups(layout: Layout, name: str) -> Iterator[Entry]:
    spec = layout.backbone
    for block, (width, stride) in enumerate(zip(spec.channels, spec.total_strides, strict=True)):
        there, here, outputs = f"{name}.{block}", f"backbone.ups.{block}", spec.up_channels
        down = stride < spec.out_stride
        size = spec.out_stride // stride if down else stride // spec.out_stride
        plain = layout.plain_up and size == 1
        shape = (outputs, width, size, size) if down or plain else (width, outputs, size, size)
        # A 1x1 convolution equals a transposed one, with the first two axes of the weight swapped.
        pick: Callable[[Tensor], Tensor] | None = (lambda weight: weight.transpose(0, 1)) if plain else None
        yield Entry(f"{there}.0.weight", shape, f"{here}.0.weight", pick)
        yield from _norm(f"{there}.1", outputs, f"{here}.1")


def _layer(name: str, shape: Shape, target: str, pick: Callable[[Tensor], Tensor] | None) -> Iterator[Entry]:
    for part, size in (("weight", shape), ("bias", shape[:1])):
        yield Entry(f"{name}.{part}", size, f"{target}.{part}", pick)


def _anchor_head(head: AnchorHead, channels: int, names: _Names, name: str) -> Iterator[Entry]:
    count, code = len(head.anchors), head.code_size

    def boxes(part: Tensor) -> Tensor:
        return part.reshape(count, code, *part.shape[1:])[:, :7].flatten(0, 1)

    def vehicle(part: Tensor) -> Tensor:
        return part[head.vehicle :: head.classes]

    for layer, outputs, target, pick in (
        ("conv_cls", count * head.classes, "classes", vehicle),
        (names.boxes, count * code, "boxes", boxes),
        ("conv_dir_cls", count * 2, "directions", None),
    ):
        yield from _layer(f"{name}.{layer}", (outputs, channels, 1, 1), f"heads.{target}", pick)


def _centre_head(head: CentreHead, channels: int, names: _Names, name: str) -> Iterator[Entry]:
    layer, norm = names.shared
    shared = f"{name}.shared_conv"
    yield from _before_norm(head, f"{shared}.{layer}", (head.shared, channels, 3, 3), "tower.shared.0")
    yield from _norm(f"{shared}.{norm}", head.shared, "tower.shared.1")

    def vehicle(part: Tensor) -> Tensor:
        return part[head.vehicle : head.vehicle + 1]

    def turn(part: Tensor) -> Tensor:
        return part if head.sine_first else part.flip(0)

    for task, classes in enumerate(head.tasks):
        heat = Branch(name=head.heat.name, outputs=classes, layers=head.heat.layers)
        stacks = [(branch, f"tower.boxes.{number}", number < 4) for number, branch in enumerate(head.branches)]
        for branch, target, kept in (*stacks, (heat, "tower.classes", True)):
            pick = {"tower.boxes.3": turn, "tower.classes": vehicle}.get(target)
            for entry in _stack(head, f"{name}.{names.tasks}.{task}.{branch.name}", branch, names, target, pick):
                yield entry if kept and task == head.task else replace(entry, target=None)


def _stack(
    head: CentreHead, name: str, branch: Branch, names: _Names, target: str,
    pick: Callable[[Tensor], Tensor] | None,
) -> Iterator[Entry]:  # fmt: skip
    layer, norm = names.stacked
    channels = head.shared
    for index in range(branch.layers - 1):
        shape = (head.hidden, channels, 3, 3)
        yield from _before_norm(head, f"{name}.{index}.{layer}", shape, f"{target}.{3 * index}")
        yield from _norm(f"{name}.{index}.{norm}", head.hidden, f"{target}.{3 * index + 1}")
        channels = head.hidden
    last = branch.layers - 1
    yield from _layer(f"{name}.{last}", (branch.outputs, channels, 3, 3), f"{target}.{3 * last}", pick)


def _before_norm(head: CentreHead, name: str, shape: Shape, target: str) -> Iterator[Entry]:
    """Yield a convolution before a norm, with its bias if the head has biases there."""
    both = _layer(name, shape, target, None)
    yield next(both)
    if head.biased:
        yield from both
