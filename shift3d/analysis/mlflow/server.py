"""MLflow web server on loopback, inside this process, so that no signal, not even SIGKILL, leaves a part running."""

from __future__ import annotations

import os
import socket
import warnings

from shift3d.analysis.mlflow.client import shared_views, short_timeouts
from shift3d.errors import InputError

HOST = "127.0.0.1"
_SHUTDOWN_S = 3  # time for requests in flight after SIGINT or SIGTERM


def open_port(port: int) -> socket.socket:
    """Open a listening socket on loopback. Early connections wait until the server is up.

    Raises: InputError: the port is taken, needs privileges or is not a port number.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((HOST, port))
        listening.listen()
    except (OSError, OverflowError) as error:
        listening.close()
        reason = getattr(error, "strerror", None) or str(error)
        remedy = "Give another port; --port 0 takes any free port"
        raise InputError(f"port {port} cannot be opened ({reason})", where=HOST, remedy=remedy) from error
    return listening


def serve(uri: str, listening: socket.socket) -> None:
    """Serve a store in one process until a signal ends it, without MLflow's eight job processes for LLM traces.

    Raises:
        InputError: the store cannot be opened.
        KeyboardInterrupt: SIGINT, after requests in flight.
    """
    import uvicorn  # before MLflow, which protects its routes against foreign origins only if uvicorn is loaded

    with short_timeouts(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MLflow's imports warn about MLflow's own libraries
        from mlflow import MlflowClient
        from mlflow.server import constants
        from mlflow.server.fastapi_app import app
        from mlflow.server.handlers import initialize_backend_stores

        artifacts = "mlflow-artifacts:/"
        os.environ |= {
            constants.BACKEND_STORE_URI_ENV_VAR: uri,
            constants.ARTIFACT_ROOT_ENV_VAR: artifacts,
            constants.SERVE_ARTIFACTS_ENV_VAR: "true",
            "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
        }
        try:
            initialize_backend_stores(uri, uri, artifacts)
        except Exception as error:  # any error of the store's driver
            reason = " ".join(str(error).split())[:200]
            raise InputError(f"the store cannot be opened ({reason})", where=uri, remedy="Give --uri") from error
        address = f"http://{HOST}:{listening.getsockname()[1]}"
        for name, path in shared_views(MlflowClient(uri)):
            print(f"runs of {name} with their AUCs: {address}/{path}", flush=True)
        config = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=_SHUTDOWN_S)
        uvicorn.Server(config).run(sockets=[listening])
