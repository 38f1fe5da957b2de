"""Check of an MLflow store's URI before the work starts, without importing MLflow."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from urllib.parse import urlsplit

from shift3d.errors import InputError
from shift3d.settings.messages import choice_error
from shift3d.settings.schema.config import MlflowConfig, NoTrackingConfig
from shift3d.store.atomic import check_writable

_SCHEMES = (
    "sqlite", "http", "https", "file", "postgresql", "mysql", "mssql", "databricks", "databricks-uc", "uc",
)  # fmt: skip
_PLUGINS = "mlflow.tracking_store"


def check_tracking(tracking: MlflowConfig | NoTrackingConfig) -> None:
    """Run `check_store` on the store that the settings name, if any."""
    if isinstance(tracking, MlflowConfig):
        check_store(tracking.uri)


def check_store(uri: str, where: str = "tracking.uri") -> None:
    """Refuse a URI that MLflow would refuse, and a file or folder that is not writable. A server may be unreachable.

    Raises: InputError: names the valid schemes, or the folder.
    """
    if not uri:
        raise InputError("no MLflow store is given", where=where, remedy="Give a store, such as sqlite:///mlflow.db")
    parts = urlsplit(uri)
    scheme = parts.scheme.partition("+")[0]  # mysql+pymysql: the database and its driver
    if not scheme:
        check_writable(Path(uri), f"{where}=...")
        return
    plugins = importlib.metadata.entry_points(group=_PLUGINS)
    known = [*_SCHEMES, *(point.name for point in plugins if point.name not in _SCHEMES)]
    if scheme not in known:
        raise choice_error("scheme", scheme, known, f"{where} {uri}")
    if scheme == "file":
        check_writable(Path(parts.path), f"{where}=...")
    elif scheme == "sqlite" and len(parts.path) > 1:
        file = Path(parts.path.removeprefix("/"))  # sqlite:///here.db, sqlite:////root/there.db
        check_writable(file.parent, f"{where}=...")
