"""A decoder's products: either library gives x W^T + b, with NaN and gradients at the right places."""

import pytest
import torch

from shift3d.processor import has_fast_bfloat16, onednn_float32_is_faster, pad_to_bucket
from shift3d.sdf import affine as module
from shift3d.sdf.affine import affine, padded_to_bucket


@pytest.fixture(params=[False, True], ids=["torch", "onednn"])
def wide(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each library in turn; oneDNN multiplies on any processor, even where it is slower."""
    if request.param and not torch.backends.mkldnn.is_available():
        pytest.skip("torch was built without oneDNN")
    monkeypatch.setattr(module, "onednn_float32_is_faster", lambda: request.param)


def parts(rows: int, inputs: int, outputs: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    draw = torch.Generator().manual_seed(rows)
    shapes = (rows, inputs), (outputs, inputs), (outputs,)
    return tuple(torch.randn(shape, generator=draw) for shape in shapes)  # type: ignore[return-value]


@pytest.mark.usefixtures("wide")
@pytest.mark.parametrize("rows", [0, 1, 7, 64, 600])
@pytest.mark.parametrize(("inputs", "outputs"), [(3, 512), (512, 512), (512, 1)])
def test_float32_is_float64_to_rounding(rows: int, inputs: int, outputs: int) -> None:
    x, weight, bias = parts(rows, inputs, outputs)
    # A sum of n products in any order is off by at most n u times the sum of their sizes (Higham 2002, 3.1).
    bound = (inputs + 1) * 2.0**-24 * (x.abs().double() @ weight.abs().double().T + bias.abs().double())
    for offset in (bias, None):
        exact = x.double() @ weight.double().T + (0.0 if offset is None else offset.double())
        assert ((affine(x, weight, offset).double() - exact).abs() <= bound).all()
    back = affine(torch.ones(rows, outputs), weight.T, None)  # as in a backward pass through the layer
    assert torch.allclose(back, torch.ones(rows, outputs) @ weight, atol=1e-3)


@pytest.mark.usefixtures("wide")
def test_what_is_not_finite_stays_so() -> None:
    x, weight, bias = parts(70, 512, 512)
    x[3, 4], x[5, 6] = torch.nan, torch.inf
    found = affine(x, weight, bias)
    assert torch.isnan(found[3]).all() and torch.isinf(found[5]).all()
    kept = torch.arange(70) % 2 == 0
    assert torch.isfinite(found[kept]).all()


@pytest.mark.usefixtures("wide")
def test_gradients_are_torchs_own() -> None:
    x, weight, bias = parts(20, 30, 40)
    leaves = [part.requires_grad_() for part in (x, weight, bias)]
    found = torch.autograd.grad(affine(*leaves).square().sum(), leaves)
    wanted = torch.autograd.grad(torch.addmm(bias, x, weight.T).square().sum(), leaves)
    assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))


@pytest.mark.skipif(
    not torch.backends.cpu.get_cpu_capability().startswith("AVX512"), reason="MKL's shorter vectors were not looked at"
)
@pytest.mark.parametrize(("inputs", "outputs"), [(3, 512), (512, 512), (512, 253), (512, 1)])
def test_a_row_is_the_same_whatever_stands_beside_it(inputs: int, outputs: int) -> None:
    x, weight, bias = parts(600, inputs, outputs)
    whole = affine(x, weight, bias)
    for rows in (16, 17, 64, 599):
        for start in (0, 1):
            part = slice(start, start + rows)
            assert torch.equal(affine(x[part].clone(), weight, bias), whole[part])


@pytest.mark.usefixtures("wide")
def test_few_points_are_filled_up_to_16() -> None:
    assert [len(padded_to_bucket(torch.ones(rows, 3))) for rows in (0, 1, 16)] == [0, 16, 16]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
def test_a_padded_batch_changes_no_value_and_holds_no_gradient_back(
    dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not onednn_float32_is_faster():
        monkeypatch.setattr(module, "onednn_float32_is_faster", lambda: True)
    x, weight, bias = (part.to(dtype) for part in parts(37, 3, 40))
    filled = padded_to_bucket(x, weight, bias)
    assert torch.equal(filled[:37], x) and not filled[37:].any()
    assert len(filled) == (
        37 if dtype == torch.float64 or (dtype == torch.bfloat16 and not has_fast_bfloat16()) else 48
    )
    assert padded_to_bucket(x, weight, bias.requires_grad_()) is x
    with torch.no_grad():
        assert len(padded_to_bucket(x, weight, bias)) == len(filled)
    assert len(padded_to_bucket(x[:0], weight)) == 0


def test_buckets_are_few_and_near() -> None:
    sizes = [pad_to_bucket(rows) for rows in range(1, 1025)]
    spare = {rows: size - rows for rows, size in enumerate(sizes, start=1)}
    assert all(0 <= more < (max(16, rows / 2) if rows <= 256 else 128) for rows, more in spare.items())
    assert sorted(set(sizes)) == [16, 32, 48, 64, 96, 128, 192, *range(256, 1025, 128)] and sizes == sorted(sizes)
    assert [pad_to_bucket(rows) for rows in (0, 4097, 100_000)] == [0, 4224, 100_096]
