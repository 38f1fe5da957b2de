"""Line counts of the package by content: ``python docs/scripts/size.py``."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "shift3d"


def lines_of(text: str) -> Counter[str]:
    """Count a file's lines: blank, docstrings, comments, imports and code."""
    kinds = [
        "blank" if not line.strip() else "comments" if line.lstrip()[0] == "#" else "code" for line in text.splitlines()
    ]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            kind = "docstrings"
        elif isinstance(node, ast.Import | ast.ImportFrom):
            kind = "imports"
        else:
            continue
        assert node.end_lineno is not None
        kinds[node.lineno - 1 : node.end_lineno] = [kind] * (node.end_lineno - node.lineno + 1)
    return Counter(kinds)


def main() -> None:
    files = {path: lines_of(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
    whole = sum(files.values(), Counter())
    render = sum((count for path, count in files.items() if "render" in path.relative_to(PACKAGE).parts[:1]), Counter())
    print(f"package {whole.total()}", f"render {render.total()}", *(f"{kind} {whole[kind]}" for kind in sorted(whole)))


if __name__ == "__main__":
    main()
