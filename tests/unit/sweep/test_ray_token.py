"""The file of Ray's token: readable by its owner alone from the start, and refused otherwise."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest

from shift3d.errors import InputError
from shift3d.sweep.execution.ray.token import require_token, token_file


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home without a token, and no setting about one."""
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"):
        # Set first, so that a variable set by require_token is undone as well.
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def permissions(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_private_ray_has_a_token_that_only_its_owner_reads() -> None:
    umask = os.umask(0)
    try:
        assert require_token(private=True)
    finally:
        os.umask(umask)
    assert permissions(token_file()) == 0o600 and permissions(token_file().parent) == 0o700
    assert len(token_file().read_text()) == 64
    assert os.environ["RAY_AUTH_MODE"] == "token"
    assert os.environ["RAY_AUTH_TOKEN_PATH"] == str(token_file())
    assert list(token_file().parent.iterdir()) == [token_file()]


def test_the_token_stays_the_same() -> None:
    require_token(private=True)
    token = token_file().read_text()
    require_token(private=True)
    assert token_file().read_text() == token


def test_drivers_that_start_at_once_agree_on_one_token() -> None:
    from shift3d.sweep.execution.ray.token import _check, _create

    barrier, seen = threading.Barrier(8), []

    def start() -> None:
        barrier.wait()
        _create(token_file())
        _check(token_file())
        seen.append(token_file().read_text())

    threads = [threading.Thread(target=start) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(seen) == 8 and len(set(seen)) == 1 and len(seen[0]) == 64


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o620, 0o604])
def test_a_token_that_others_can_read_or_write_is_refused(
    home: Path, monkeypatch: pytest.MonkeyPatch, mode: int
) -> None:
    path = home / "token"
    path.write_text("a" * 64)
    path.chmod(mode)
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(path))
    for private in (True, False):
        with pytest.raises(InputError, match=rf"others can read or write .*{mode:04o}.*chmod 600"):
            require_token(private)
    assert "RAY_AUTH_MODE" not in os.environ


def test_what_is_no_token_is_refused(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (home / "empty").touch(0o600)
    (home / "folder").mkdir(0o700)
    os.mkfifo(home / "pipe", 0o600)
    for name in ("empty", "folder", "pipe", "absent"):
        monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(home / name))
        with pytest.raises(InputError, match=name):
            require_token(private=False)


def test_a_home_that_cannot_be_written_to_is_said(home: Path) -> None:
    (home / ".shift3d").touch()
    with pytest.raises(InputError, match=r"no token can be written.*RAY_AUTH_TOKEN_PATH"):
        require_token(private=True)


def test_a_cluster_has_the_token_of_rays_own_commands_or_none_that_we_know(home: Path) -> None:
    assert not require_token(private=False)
    assert "RAY_AUTH_MODE" not in os.environ, "the cluster may be one that asks for none"
    path = home / ".ray" / "auth_token"
    path.parent.mkdir()
    path.write_text("a" * 64)
    path.chmod(0o600)
    assert require_token(private=False)
    assert os.environ["RAY_AUTH_TOKEN_PATH"] == str(path)


def test_what_the_user_said_stands(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_AUTH_TOKEN", "b" * 64)
    assert require_token(private=True) and not token_file().exists()
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    assert not require_token(private=True)
    assert os.environ["RAY_AUTH_MODE"] == "disabled"
