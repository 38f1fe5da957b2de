"""Names and texts use the field's terms: words that only this project would understand are refused."""

from __future__ import annotations

import ast
import io
import re
import subprocess
import tokenize
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
HERE = Path(__file__).relative_to(ROOT)
# As a part of a name, split at `_` and capitals. Names of tests are sentences and exempt.
PRIVATE_NAMES = {
    *("anew", "asked", "crew", "edition", "editions", "follower", "followers", "freight", "greet", "leaps", "said"),
    *("sight", "slack", "standing", "tangents", "told", "twin", "twins", "worth"),
}
PRIVATE_TERMS = (
    *("CoarseField", "EmptySpace", "FieldLattice", "called_for", "coarse_band_m", "cover_rays", "editions"),
    *("empty_space", "grazing_floor", "guarded_box", "kept_step", "look_between", "round_batch", "settle_numerics"),
    *("silent beams?", "silent_beams", "sphere_m", "steady_steps", "still_a_car", "twins?", "unchecked_m"),
)
# Words of a diary: the past is in git.
DIARY = (
    "anew",
    "by this version",
    "gave up on",
    "of this version",
    "given up on",
    "nobody's fault",
    "previously",
    "until now",
)
# Old names that are refused with the valid one, or read from older folders; a program's English.
ALLOWED = {
    "shift3d/settings/renamed.py": PRIVATE_TERMS,
    "shift3d/store/migrations.py": ("still_a_car",),
    "shift3d/task/spec.py": ("silent_beams", "steady_steps", "sphere_m"),
    "tests/unit/settings/test_renamed.py": PRIVATE_TERMS,
    "tests/unit/settings/test_frontier_config.py": ("grazing_floor",),
    "tests/unit/task/test_spec.py": ("silent_beams", "steady_steps", "sphere_m"),
    "tests/service/test_older_folders.py": ("still_a_car",),
}


def tracked(*patterns: str) -> list[str]:
    done = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=False)
    if not done.stdout:
        pytest.skip("no git checkout")
    return [name for name in done.stdout.split() if (ROOT / name).is_file()]


def words_of(name: str) -> set[str]:
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z0-9]+", name)}


def _contains(text: str, parts: Iterable[str]) -> bool:
    """True if a part is somewhere in the text, in any case. Much faster than a regular expression."""
    low = text.lower()
    return any(part.lower() in low for part in parts)


def test_no_name_is_a_word_of_ours() -> None:
    found = []
    for path in tracked("shift3d/*.py", "tests/*.py", "docs/scripts/*.py"):
        text = (ROOT / path).read_text(encoding="utf-8")
        if not _contains(text, PRIVATE_NAMES):
            continue  # the tokens of all files take seconds
        source = io.StringIO(text)
        names = {token.string for token in tokenize.generate_tokens(source.readline) if token.type == tokenize.NAME}
        found += [
            f"{path}: {name}" for name in names if not name.startswith("test_") and words_of(name) & PRIVATE_NAMES
        ]
    assert sorted(found) == [], "use the term of the field"


@pytest.mark.parametrize("terms", [PRIVATE_TERMS, DIARY], ids=["private terms", "diary"])
def test_no_text_has_a_term_of_ours(terms: tuple[str, ...]) -> None:
    pattern = re.compile("|".join(rf"\b{term}\b" for term in terms), re.IGNORECASE)
    found = []
    for path in tracked(
        "*.py", "*.md", "*.yaml", "*.toml", "*.j2", "*.js", "*.sh", "Makefile", ":!tests/reference", f":!{HERE}"
    ):
        allowed, text = {term.lower() for term in ALLOWED.get(path, ())}, (ROOT / path).read_text(encoding="utf-8")
        if not _contains(text, [term.removesuffix("s?") for term in terms]):
            continue
        for number, line in enumerate(text.splitlines(), 1):
            found += [f"{path}:{number}: {hit}" for hit in pattern.findall(line) if hit.lower() not in allowed]
    assert found == [], "use the term of the field, and no history"


def test_a_docstring_names_its_subject() -> None:
    """No docstring begins with a clause ("What ...", "Where ...") in place of a noun or a verb."""
    clause = re.compile(r"(What|Whether|Where|How|Which|Those|That|When|As|Who|Why|If|Of|With|Without)\b")
    begins = re.compile(rf"^\s*\w?[\"']+{clause.pattern}", re.MULTILINE)
    found = []
    for path in tracked("shift3d/*.py", "tests/*.py", "docs/scripts/*.py"):
        text = (ROOT / path).read_text(encoding="utf-8")
        if not begins.search(text):
            continue  # parsing all files takes seconds
        tree = ast.parse(text)
        texts = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
        found += [
            f"{path}:{text.lineno}: {text.value[:60]}"
            for text in texts
            if isinstance(text, ast.Constant) and isinstance(text.value, str) and clause.match(text.value)
        ]
    assert found == [], 'begin with a noun, a verb, or "True if"'
