"""Rule that aborts a sweep: early or frequent failures have a cause that the remaining tasks probably share."""

from __future__ import annotations

from collections import Counter

from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.sweep.execution.worker import BatchOutcome
from shift3d.wording import counted

# The failed share of fewer tasks says little.
_LEAST_TASKS = 50
# Length of the message beginning by which errors are alike: names and numbers of a single task come later.
_HEAD = 24


class AbortedError(InputError):
    """Error for too many failed tasks. Committed results stay, and the same command resumes."""

    exit_code = ExitCode.ABORTED


class AbortRule:
    """Counter of the outcomes of one run that decides when to abort.

    Args: after: abort if the first `after` tasks failed alike. share: abort if more than this share of at least 50
    tasks failed. None disables the limit.
    """

    def __init__(self, after: int | None, share: float | None) -> None:
        self._after = after
        self._share = share
        self._done = 0
        self._failed = 0
        self._errors: Counter[str] = Counter()
        self._example: dict[str, str] = {}

    def seen(self, outcome: BatchOutcome) -> AbortedError | None:
        """Count an outcome. Return the error to abort with, or None."""
        self._done += len(outcome.done)
        self._failed += len(outcome.quarantined)
        for error in outcome.errors:
            head = error[: error.find(":") + 1 + _HEAD]
            self._errors[head] += 1
            self._example.setdefault(head, error)
        if not outcome.quarantined:
            return None
        head, count = self._errors.most_common(1)[0]
        if self._after and not self._done and count == self._failed >= self._after:
            return self._error(f"the first {counted(count, 'task')} failed alike", head, "runner.abort_after=null")
        ended = self._done + self._failed
        if self._share and ended >= _LEAST_TASKS and self._failed > self._share * ended:
            what = f"{self._failed} of {ended} tasks failed, more than {self._share:.0%}"
            return self._error(f"{what}; {count} of them", head, "runner.abort_share=null")
        return None

    def _error(self, what: str, head: str, switch: str) -> AbortedError:
        example = " ".join(self._example[head].split())[:300]
        remedy = (
            f"Repair it and run the same command with --retry-quarantined, or give {switch} to go on in spite of it"
        )
        return AbortedError(f"stopped: {what}: {example}", remedy=remedy)
