"""Messages for the errors of an object store: cause and remedy."""

from __future__ import annotations

import re

from shift3d.errors import InputError


class SilentStoreError(InputError):
    """Error for a store that does not answer, or cannot be reached: a later try may succeed."""


def is_silence(error: InputError) -> bool:
    """True if a silent store caused the error, directly or as the cause of an `UncertainError`."""
    return isinstance(error, SilentStoreError) or isinstance(error.__cause__, SilentStoreError)


CREDENTIALS = {
    "s3": "Set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or give the machine a role",
    "gs": "Set GOOGLE_SERVICE_ACCOUNT to a key file, or give the machine a service account",
}
CHECK = {
    "s3": "Check AWS_ENDPOINT_URL, AWS_REGION and the network, and run the same command again",
    "gs": "Check the network and GOOGLE_BASE_URL, and run the same command again",
}
_ALLOWED = "Check them, and that they may list, read, write and delete there"
# Pattern in the error text, cause, remedy; the first match counts. {credentials} and {check} depend on the store.
_MEANINGS = (
    ("NoSuchBucket|bucket does not exist", "there is no such bucket", "Create it, or give another one"),
    ("InvalidBucketName", "is not the name of a bucket", "Give another one"),
    (
        r"169\.254\.|metadata\.google|fd00:ec2|OpenCredentials|[Cc]redential error|service account file",
        "no credentials that can be used were found",
        "{credentials}",
    ),
    (
        "InvalidAccessKeyId|SignatureDoesNotMatch|Unauthenticated|InvalidToken|ExpiredToken|401 Unauthorized",
        "the credentials are refused",
        "{credentials}",
    ),
    ("AccessDenied|PermissionDenied|403 Forbidden|lacked valid", "the credentials may not do this", _ALLOWED),
    (
        "conditional put is disabled|501 Not Implemented|NotImplemented",
        "this store cannot create an object only if it is absent, which the commit log needs",
        "Use one that honours If-None-Match (AWS S3, Google Cloud Storage, a recent MinIO), or a folder",
    ),
    (
        "builder error",
        "this endpoint cannot be used",
        "Give AWS_ENDPOINT_URL as https://HOST, or for http://HOST set AWS_ALLOW_HTTP=true",
    ),
    (
        "error sending request|timed out|operation timed|dns error|Connection",
        "cannot be reached",
        "{check}",
    ),
    (r"50[0234] |SlowDown|429 ", "the store does not answer", "{check}"),
)


def store_error(error: Exception, url: str) -> InputError:
    """Return an InputError with the URL, the cause and the remedy. error: as obstore raised it."""
    text = f"{type(error).__name__} {error}"
    scheme = url.partition("://")[0]
    for pattern, what, remedy in _MEANINGS:
        if re.search(pattern, text):
            # A network error also names the host and the number of tries.
            request = f" ({_request(text)})" if remedy == "{check}" else ""
            remedy = remedy.format(credentials=CREDENTIALS[scheme], check=CHECK[scheme])
            kind = SilentStoreError if request else InputError
            return kind(what + request, url, remedy)
    first = " ".join(str(error).split("Debug source")[0].split())[:300]
    return InputError(f"the store refuses ({first})", url, CHECK[scheme])


def check_endpoint(name: str, value: str) -> None:
    """Refuse an endpoint that is no http(s) URL, on which obstore fails with a traceback. name: of the variable."""
    form = r"https?://([^/@\s]+@)?(\[[\da-fA-F:.]+\]|[^/:@\s?#\[\]]+)(:(?P<port>\d+))?(/[^\s?#]*)?"
    found = re.fullmatch(form, value)
    if found is None or int(found["port"] or 0) > 65_535:
        remedy = f"Give {name} as https://HOST, or as http://HOST:PORT with AWS_ALLOW_HTTP=true"
        raise InputError(f"{value!r} is no address of a store", name, remedy)


def _request(text: str) -> str:
    host = re.search(r"https?://[^/\s]+", text)
    tries = re.search(r"after (\d+) retries", text)
    return (host[0] if host else "no answer") + (f", tried {int(tries[1]) + 1} times" if tries else "")
