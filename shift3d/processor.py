"""What the processor does well, for choices that change time and not results that are compared."""

from __future__ import annotations

import functools

__all__ = ["has_fast_bfloat16"]


@functools.cache
def has_fast_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 matrices with instructions of its own.

    Where it has none they are emulated, some sixty times slower than float32 (measured: 1.2 against 70 GFLOP/s on
    one core with AVX2 alone), so that every use of bfloat16 on CPU asks here first.
    """
    import torch

    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
