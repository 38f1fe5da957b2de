"""The README's pictures agree with the tables."""

from __future__ import annotations

from pathlib import Path

import pytest
from scripts.pictures import main

from shift3d.errors import InputError


def test_a_folder_that_is_no_sweep_is_named_and_nothing_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="usage"):
        main([f"folder={tmp_path / 'pictures'}"])
    with pytest.raises(InputError, match="elsewhere"):
        main([str(tmp_path / "elsewhere"), f"folder={tmp_path / 'pictures'}"])
    assert not (tmp_path / "pictures").exists()
