"""SST: grouping by windows drops no token, attention is the textbook's, and its reach follows from the windows."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from shift3d.detectors.models.sst import SST_SPEC, SstNet, SstSpec
from shift3d.detectors.models.token_windows import Tokens, aligned_span, gather_rows, group_by_window
from shift3d.detectors.models.window_transformer import EncoderLayer, TransformerSpec, WindowTransformer, position_codes
from shift3d.detectors.trained_detector import TrainedDetector

SMALL = TransformerSpec(width=16, heads=2, feed_forward=32, blocks=1, window=4, lengths=(3, 7))
NET = SstSpec(SMALL, encoder_hidden=8, out_channels=8)


def _tokens(count: int, cells: int, seed: int, batches: int = 2) -> Tokens:
    """Return distinct cells in the network's order: by batch, then y, then x."""
    rng = np.random.default_rng(seed)
    flat = np.sort(rng.choice(batches * cells * cells, count, replace=False))
    return Tokens(flat // cells**2, flat % cells, flat // cells % cells)


@given(st.integers(0, 250), st.integers(0, 5), st.sampled_from([0, 2]))
@settings(max_examples=40, deadline=None)
def test_every_token_has_one_slot_in_the_window_it_lies_in(count: int, seed: int, shift: int) -> None:
    tokens = _tokens(count, 12, seed)
    groups = group_by_window(tokens, 4, shift, (3, 7))
    assert torch.equal(groups.slot_token[groups.token_slot], torch.arange(count))
    assert sum(bucket.windows * bucket.length for bucket in groups.buckets) == groups.slot_token.numel()
    parts = groups.slot_token.split([bucket.windows * bucket.length for bucket in groups.buckets])
    for bucket, slots in zip(groups.buckets, parts, strict=True):
        filled = (slots < count).view(bucket.windows, bucket.length)
        assert (bucket.padding is None) == bool(filled.all())
        if bucket.padding is not None:
            assert torch.equal(bucket.padding.view_as(filled), filled)
        for row in slots.view(bucket.windows, bucket.length).numpy():
            members = row[row < count]
            windows = {
                (int(tokens.batch[m]), int(tokens.cell_x[m] + shift) // 4, int(tokens.cell_y[m] + shift) // 4)
                for m in members
            }
            assert len(windows) == 1
            assert bucket.length == next(length for length in (3, 7, 16) if len(members) <= length)


def test_a_full_window_fits_whatever_the_lengths() -> None:
    full = Tokens(np.zeros(144, dtype=np.int64), np.tile(np.arange(12), 12), np.repeat(np.arange(12), 12))
    groups = group_by_window(full, 12, 0, (30, 60, 100))
    assert [(bucket.windows, bucket.length) for bucket in groups.buckets] == [(1, 144)]
    assert groups.place.tolist() == list(range(144))


def test_gather_is_its_own_derivative() -> None:
    rows = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    index, inverse = torch.tensor([2, 4, 0, 3]), torch.tensor([2, 4, 0, 3])  # row 1 unused, slot 1 empty
    gathered = gather_rows(rows, index, inverse)
    assert torch.equal(gathered[1], torch.zeros(3, dtype=torch.float64))
    assert torch.equal(gathered[[0, 2, 3]], rows[[2, 0, 3]])
    assert torch.autograd.gradcheck(lambda x: gather_rows(x, index, inverse), rows)


def _plain_attention(layer: EncoderLayer, window: torch.Tensor, positions: torch.Tensor) -> torch.Tensor:
    """Return one window's tokens after the layer, written as in the textbook."""
    width = window.shape[1]
    query, key = layer.query_key(window + positions).split(width, dim=1)
    value = layer.value(window)
    heads = []
    for part in torch.arange(width).chunk(layer.heads):
        weights = torch.softmax(query[:, part] @ key[:, part].T / len(part) ** 0.5, dim=1)
        heads.append(weights @ value[:, part])
    middle = layer.norm_attention(window + layer.out(torch.cat(heads, dim=1)))
    return layer.norm_feed_forward(middle + layer.narrow(torch.nn.functional.gelu(layer.widen(middle))))


@pytest.mark.parametrize("count", [1, 2, 90, 250])
def test_windowed_attention_equals_the_textbook_s_window_by_window(count: int) -> None:
    torch.manual_seed(1)
    layer = EncoderLayer(SMALL).double()
    tokens = _tokens(count, 12, seed=3)
    groups = group_by_window(tokens, 4, 2, SMALL.lengths)
    features = torch.randn(count, 16, dtype=torch.float64)
    positions = position_codes(4, 16).double()[groups.place]
    found = layer(features, positions, groups)
    owner = np.stack((tokens.batch, (tokens.cell_x + 2) // 4, (tokens.cell_y + 2) // 4))
    for window in np.unique(owner, axis=1).T:
        members = torch.from_numpy((owner == window[:, None]).all(axis=0).nonzero()[0])
        assert torch.allclose(
            found[members], _plain_attention(layer, features[members], positions[members]), atol=1e-12
        )


def test_position_codes_differ_and_are_bounded() -> None:
    codes = position_codes(12, 128)
    assert codes.shape == (144, 128) and codes.abs().max() <= 1
    assert (torch.cdist(codes, codes) + 9 * torch.eye(144)).min() > 0.5


@pytest.mark.parametrize(("low", "high", "shift"), [(0, 4, 0), (3, 5, 0), (3, 5, 2), (0, 1, 2), (-2, 2, 2)])
def test_aligned_span_is_the_smallest_of_whole_windows(low: int, high: int, shift: int) -> None:
    start, end = aligned_span(low, high, 4, shift)
    assert start <= low and end >= high
    assert (start + shift) % 4 == (end + shift) % 4 == 0
    assert low - start < 4 and end - high < 4


def test_the_reach_of_the_layers_is_that_of_their_windows() -> None:
    """The test collects the tokens that an output's gradient touches, on a map where every cell is a token."""
    torch.manual_seed(0)
    transformer = WindowTransformer(TransformerSpec(width=8, heads=2, feed_forward=8, blocks=2, window=4)).double()
    cells = 40
    y, x = (axis.reshape(-1) for axis in np.mgrid[:cells, :cells])
    tokens = Tokens(np.zeros(cells * cells, dtype=np.int64), x, y)
    features = torch.randn(cells * cells, 8, dtype=torch.float64, requires_grad=True)
    found, _ = transformer(features, tokens, (0, cells), (0, cells))
    found[20 * cells + 21, 0].backward()  # one channel: a layer norm's channels sum to a constant
    assert features.grad is not None
    touched = features.grad.abs().sum(dim=1).view(cells, cells).nonzero()
    low_x, high_x = transformer.needed_spans(21, 22)[0]
    low_y, high_y = transformer.needed_spans(20, 21)[0]
    assert touched.min(dim=0).values.tolist() == [low_y, low_x]
    assert touched.max(dim=0).values.tolist() == [high_y - 1, high_x - 1]


def test_letting_tokens_go_changes_nothing() -> None:
    torch.manual_seed(0)
    transformer = WindowTransformer(TransformerSpec(width=8, heads=2, feed_forward=8, blocks=3, window=4)).double()
    tokens = _tokens(1500, 60, seed=0, batches=1)
    features = torch.randn(1500, 8, dtype=torch.float64)
    everything, _ = transformer(features, tokens, (0, 60), (0, 60))
    part, kept = transformer(features, tokens, (22, 31), (7, 19))
    inside = (tokens.cell_x >= 22) & (tokens.cell_x < 31) & (tokens.cell_y >= 7) & (tokens.cell_y < 19)
    assert 0 < inside.sum() == len(kept.cell_x)
    assert torch.allclose(part, everything[torch.from_numpy(inside)], atol=1e-12)


def test_a_batch_is_its_scenes_one_by_one() -> None:
    torch.manual_seed(0)
    net = SstNet(NET).double().eval()
    windows = [TrainedDetector(net, "float64").window_for(centre, 3.0) for centre in ((0.0, 0.0), (19.2, -8.96))]
    shapes = {(window.num_x, window.num_y, window.core_num_x, window.core_num_y) for window in windows}
    assert len(shapes) == 1, "the centres were chosen for windows of one shape"
    rng = torch.Generator().manual_seed(2)
    clouds = [(torch.rand(3000, 3, generator=rng, dtype=torch.float64) - 0.5) * 60 for _ in windows]
    for cloud in clouds:
        cloud[:, 2] *= 0.05
    with torch.no_grad():
        joint = net(clouds, windows)
        for index, (cloud, window) in enumerate(zip(clouds, windows, strict=True)):
            assert torch.allclose(joint[index], net([cloud], [window])[0], atol=1e-12)


def test_the_published_size() -> None:
    net = SstNet(SST_SPEC)
    assert len(net.transformer.layers) == 12
    transformer = sum(parameter.numel() for parameter in net.transformer.parameters())
    # Twelve layers of four projections, two feed-forward layers and two norms, each with its biases.
    assert transformer == 12 * (4 * (128 * 128 + 128) + (128 * 256 + 256) + (256 * 128 + 128) + 4 * 128)


def test_one_point_alone_is_a_scene() -> None:
    torch.manual_seed(0)
    detector = TrainedDetector(SstNet(NET))
    points = torch.tensor([[5.0, 5.0, 0.5]], requires_grad=True)
    found = detector.proposals(points, detector.window_for((5.0, 5.0), 3.0))
    found.logits.sum().backward()
    assert torch.isfinite(found.logits).all() and torch.isfinite(found.boxes).all()
    assert points.grad is not None and torch.isfinite(points.grad).all()
