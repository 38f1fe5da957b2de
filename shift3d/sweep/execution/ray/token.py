"""Authentication token of Ray, in a file that only its owner can read."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
import sys
from pathlib import Path

from shift3d.errors import InputError

_MODE, _TOKEN, _PATH = "RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"


def require_token(private: bool) -> bool:
    """Turn Ray's token authentication on for this process and its children. Return True if it is on.

    Ray's own variables have priority: RAY_AUTH_MODE=disabled turns it off, RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH name
    the token. Otherwise a private Ray uses the token of :func:`token_file`, which is made if absent, and a cluster the
    token of Ray's own commands, ``~/.ray/auth_token``. A cluster without a known token may need none: False.

    Source: our choice. Ray itself would make a token in a file that everybody on the machine can read.

    Raises: InputError: the file cannot be made or read, holds no token, or others can read it too.
    """
    if os.environ.get(_MODE, "token").lower() != "token":
        return False
    if not os.environ.get(_TOKEN):
        path_text = os.environ.get(_PATH)
        path = Path(path_text) if path_text else token_file() if private else Path.home() / ".ray" / "auth_token"
        if private:
            _create(path)
        elif not path_text and not path.exists():
            return False
        _check(path)
        os.environ[_PATH] = str(path)
    os.environ[_MODE] = "token"
    if "ray" in sys.modules:
        # Ray reads both variables on import, and caches them.
        from ray._raylet import AuthenticationTokenLoader, Config  # type: ignore[attr-defined]

        Config.initialize("")
        AuthenticationTokenLoader.instance().reset_cache()
    return True


def token_file() -> Path:
    """Return the file that keeps the token of private Rays between runs."""
    return Path.home() / ".shift3d" / "ray_token"


def _create(path: Path) -> None:
    """Create a file with 256 random bits that only its owner can ever read; an existing file stays."""
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        # The file is complete before it gets its name: a concurrent start reads the whole token or none.
        temporary = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
        try:
            with os.fdopen(descriptor, "w") as file:
                file.write(secrets.token_hex(32))
            with contextlib.suppress(FileExistsError):
                os.link(temporary, path)
        finally:
            temporary.unlink()
    except OSError as error:
        what = f"no token can be written ({error.strerror})"
        raise InputError(what, where=str(path), remedy=f"Name another file in {_PATH}") from error


def _check(path: Path) -> None:
    """Refuse a token that others can read or write, or that is none."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            about = os.fstat(descriptor)
            if not stat.S_ISREG(about.st_mode):
                raise InputError("is no file", where=str(path), remedy=f"Name the token's file in {_PATH}")
            token = file.read(4097).strip()
    except OSError as error:
        raise InputError(
            f"the token of Ray cannot be read ({error.strerror})",
            where=str(path),
            remedy=f"Name its file in {_PATH}, or make one: ray get-auth-token --generate",
        ) from error
    if about.st_mode & 0o077 or about.st_uid not in (os.getuid(), 0):
        raise InputError(
            f"others can read or write this token of Ray (mode {stat.S_IMODE(about.st_mode):04o})",
            where=str(path),
            remedy=f"Make another one, since this one may be known: rm {path}. To keep it: chmod 600 {path}",
        )
    if not token or len(token) > 4096:
        raise InputError("holds no token of Ray", where=str(path), remedy=f"Remove it: rm {path}")
