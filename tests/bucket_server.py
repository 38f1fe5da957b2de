"""A real S3 server on loopback: moto's."""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
from collections.abc import Iterator
from typing import Any

import boto3
from moto.moto_server.werkzeug_app import DomainDispatcherApplication
from moto.server import ThreadedMotoServer

_PUT, _ANSWER = threading.Lock(), DomainDispatcherApplication.__call__
_NUMBERS = itertools.count()
ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_REGION": "us-east-1",
    "AWS_ALLOW_HTTP": "true",
    "AWS_EC2_METADATA_DISABLED": "true",
}


def _one_put_at_a_time(self: Any, environ: dict[str, Any], start_response: Any) -> Any:
    """Handle one PUT at a time. S3 creates an object in one step; moto checks for it first and then writes."""
    with _PUT if environ["REQUEST_METHOD"] == "PUT" else contextlib.nullcontext():
        return _ANSWER(self, environ, start_response)


@contextlib.contextmanager
def bucket_server() -> Iterator[str]:
    """Run moto's HTTP server on a free port and yield its endpoint."""
    DomainDispatcherApplication.__call__ = _one_put_at_a_time  # type: ignore[method-assign]
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        yield f"http://{host}:{port}"
    finally:
        server.stop()


def new_bucket(endpoint: str) -> str:
    """Make a bucket and return its name."""
    name = f"bucket{os.getpid()}n{next(_NUMBERS)}"
    keys = {"aws_access_key_id": "test", "aws_secret_access_key": "test", "region_name": "us-east-1"}
    boto3.client("s3", endpoint_url=endpoint, **keys).create_bucket(Bucket=name)
    return name
