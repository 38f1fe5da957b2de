"""Damage to files, drawn from a seed: bytes and text; for plain values and arrays see `value_mutations`.

Every function takes the content and a generator and returns changed content; the same generator state gives the same
change. Changes model real faults: flipped bits, copies that end early, columns in the wrong place, values of faulty
computations (NaN, infinity, subnormal numbers), lengths in headers that no file of this size can have.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

Rng = np.random.Generator
Array = np.ndarray[Any, Any]

ABSURD_INTEGERS = (0, 1, 0x7F, 0xFF, 0xFFFF, 2**24 + 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**53, 2**63 - 1, 2**64 - 1)
SPECIAL_FLOATS = (
    *(float("nan"), float("inf"), float("-inf"), 3.4e38, -3.4e38, 1e30, -1e20, 1e9, 70_000.0),
    *(1e-300, 1e-40, -1e-42, 1e-7, 0.0, -0.0, -1.0),
)
WORDS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e309", "1e-320", "0", "-1", "1e20", "123456789012345678901234567890"),
    *("''", '"', "null", "~", "true", "None", "0x1F", "1_000", "1,5", "1e", "--", "abc", "\u00e9", "\u0663", "\x00"),
)


def pick(choices: tuple[Any, ...] | list[Any], rng: Rng) -> Any:
    """Return one of the choices."""
    return choices[int(rng.integers(len(choices)))]


def span(length: int, rng: Rng, longest: int = 64) -> tuple[int, int]:
    """Return (start, end) of a random stretch within this length, mostly short."""
    start = int(rng.integers(length + 1))
    return start, min(length, start + int(rng.integers(1, max(2, min(longest, length) + 1))))


# --- bytes


def flip_bits(content: bytes, rng: Rng) -> bytes:
    data = bytearray(content)
    for _ in range(int(pick((1, 1, 1, 2, 8, 64), rng))):
        if data:
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(data)


def flip_early_bits(content: bytes, rng: Rng) -> bytes:
    """Flip bits near the beginning, where headers are."""
    head = min(len(content), 256)
    return flip_bits(content[:head], rng) + content[head:]


def truncate(content: bytes, rng: Rng) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def truncate_a_little(content: bytes, rng: Rng) -> bytes:
    return content[: max(0, len(content) - int(rng.integers(1, 20)))]


def insert(content: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(content) + 1))
    return content[:at] + rng.bytes(int(rng.integers(1, 40))) + content[at:]


def delete(content: bytes, rng: Rng) -> bytes:
    start, end = span(len(content), rng)
    return content[:start] + content[end:]


def overwrite(content: bytes, rng: Rng) -> bytes:
    start, end = span(len(content), rng, 512)
    filler = pick((b"\x00", b"\xff", b" ", None), rng)
    return content[:start] + (rng.bytes(end - start) if filler is None else filler * (end - start)) + content[end:]


def swap_blocks(content: bytes, rng: Rng) -> bytes:
    cuts = sorted(int(cut) for cut in rng.integers(0, len(content) + 1, 3))
    first, second = content[cuts[0] : cuts[1]], content[cuts[1] : cuts[2]]
    return content[: cuts[0]] + second + first + content[cuts[2] :]


def repeat_block(content: bytes, rng: Rng) -> bytes:
    start, end = span(len(content), rng, 512)
    return content[:end] + content[start:end] * int(rng.integers(1, 5)) + content[end:]


def absurd_length(content: bytes, rng: Rng) -> bytes:
    """Write an integer of 4 or 8 bytes near the beginning, as a header's length, count or offset."""
    size = int(pick((4, 8), rng))
    value = int(pick(ABSURD_INTEGERS, rng)) % 256**size
    reach = min(len(content), int(pick((16, 128, 4096), rng)))
    at = int(rng.integers(max(1, reach - size + 1))) // 4 * 4
    return content[:at] + value.to_bytes(size, "little") + content[at + size :]


def special_number(content: bytes, rng: Rng) -> bytes:
    """Write NaN, infinity, a huge or a subnormal number at the place of a float32 or float64."""
    kind = pick(("<f4", "<f8", ">f4"), rng)
    with np.errstate(over="ignore"):
        raw = np.array(pick(SPECIAL_FLOATS, rng)).astype(kind).tobytes()
    at = int(rng.integers(max(1, len(content) - len(raw) + 1))) // 4 * 4
    return content[:at] + raw + content[at + len(raw) :]


BYTES: tuple[Callable[[bytes, Rng], bytes], ...] = (
    *(flip_bits, flip_early_bits, truncate, truncate_a_little, insert, delete, overwrite, swap_blocks, repeat_block),
    *(absurd_length, special_number),
)


def mutate_bytes(content: bytes, rng: Rng) -> bytes:
    """Make one change, sometimes several."""
    for _ in range(int(pick((1, 1, 1, 1, 3), rng))):
        content = pick(BYTES, rng)(content, rng)
    return content


# --- text

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def replace_number(text: str, rng: Rng) -> str:
    found = list(_NUMBER.finditer(text))
    if not found:
        return text + str(pick(WORDS, rng))
    at = pick(found, rng)
    return text[: at.start()] + str(pick(WORDS, rng)) + text[at.end() :]


def _by_words(text: str, change: Callable[[list[str]], list[str]]) -> str:
    return "".join(change(re.findall(r"\s+|[^\s]+", text)))


def _by_lines(text: str, change: Callable[[list[str]], list[str]]) -> str:
    return "".join(change(text.splitlines(keepends=True)))


def _drop(parts: list[str], rng: Rng) -> list[str]:
    at = int(rng.integers(len(parts))) if parts else 0
    return parts[:at] + parts[at + 1 :]


def _double(parts: list[str], rng: Rng) -> list[str]:
    at = int(rng.integers(len(parts))) if parts else 0
    return parts[:at] + parts[at : at + 1] * int(rng.integers(2, 4)) + parts[at + 1 :]


def _swap(parts: list[str], rng: Rng) -> list[str]:
    if parts:
        i, j = rng.integers(len(parts), size=2)
        parts[i], parts[j] = parts[j], parts[i]
    return parts


def change_words(text: str, rng: Rng) -> str:
    change = pick((_drop, _double, _swap), rng)
    return _by_words(text, lambda parts: change(parts, rng))


def change_lines(text: str, rng: Rng) -> str:
    change = pick((_drop, _double, _swap), rng)
    return _by_lines(text, lambda parts: change(parts, rng))


def odd_character(text: str, rng: Rng) -> str:
    at = int(rng.integers(len(text) + 1))
    odd = pick(
        ("\x00", "\ufeff", '"', "{", "[", "]", ":", ",", "\t", "\u00a0", "\x85", "\u2028", "#", "${a}", "-"), rng
    )
    return text[:at] + str(odd) + text[at + int(rng.integers(2)) :]


def cut_text(text: str, rng: Rng) -> str:
    return text[: int(rng.integers(len(text) + 1))]


TEXT: tuple[Callable[[str, Rng], str], ...] = (replace_number, change_words, change_lines, odd_character, cut_text)


def mutate_text(content: bytes, rng: Rng) -> bytes:
    """Change text: two thirds as text, one third as bytes, which can break UTF-8."""
    if rng.uniform() < 0.25:
        return mutate_bytes(content, rng)
    text = content.decode()
    for _ in range(int(pick((1, 1, 1, 3), rng))):
        text = pick((replace_number, *TEXT), rng)(text, rng)
    return text.encode(errors="surrogateescape")
