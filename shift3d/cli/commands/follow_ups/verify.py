"""\
Checks that low scores are not numerical errors. Scores every solution of a finished sweep again: rendered exactly in
float64, with new noise on the beams that hit the vehicle, and at poses slightly off its own. Writes the result to
OUT/final: columns score_reference and stable of scores.parquet, all values in verification.parquet, and the page
stability.html. The same command resumes. A sweep that runs again keeps its verification.

examples:
  shift3d verify outputs/default-1a2b3c4d5e6f7a8b                   on Ray, like the sweep
  shift3d verify outputs/default-1a2b3c4d5e6f7a8b runner=local      in this process
  shift3d verify outputs/default-1a2b3c4d5e6f7a8b runner.workers=2 runner.address=auto

stable: score and margin to the baseline are within 0.02 of the reference's.
robust: under every draw of noise and pose at least half of the margin remains, or at most 0.02 of score is lost.
A solution takes about as long as twenty steps of its attack; the reference rendering takes more than half of that."""

from __future__ import annotations

import argparse
import sys

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command
from shift3d.cli.outcomes import interrupted
from shift3d.cli.sweep_arguments import RUNNER_ARGUMENT, compose_runner
from shift3d.exit_codes import ExitCode
from shift3d.wording import counted


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.html.sections.stability import write_stability_page
    from shift3d.analysis.results import with_effects_requested
    from shift3d.analysis.tables.accuracy.cost import diagnostics
    from shift3d.analysis.tables.stability import stability_lines
    from shift3d.processor import configure_runtime
    from shift3d.store.resolve import as_location
    from shift3d.sweep.follow_up import solved_tasks, verify_sweep

    configure_runtime()
    folder = as_location(arguments.out)
    runner = compose_runner(arguments.words, "verify")
    plan = solved_tasks(folder)
    print(f"verifying {counted(len(plan.tasks), 'task')} of {folder}", flush=True)
    result = verify_sweep(folder, plan, runner)
    if result.final is None:
        return interrupted(result, "verified")
    scores = result.final.frame("scores")
    verification = with_effects_requested(result.final.frame("verification"), plan.tasks)
    print(f"\n{stability_lines(verification)}\n\n{diagnostics(scores)}\n")
    page = write_stability_page(folder / "final" / "stability.html", plan.sweep, scores, verification)
    print(f"{page} written in {result.seconds:.0f} s; the sweep's command copies it to MLflow")
    if result.quarantined:
        attempts = folder / "verification" / "final" / "attempts.parquet"
        print(f"{counted(result.quarantined, 'task')} could not be verified: {attempts}", file=sys.stderr)
        return int(ExitCode.INCOMPLETE)
    return 0


COMMAND = Command(
    "verify",
    "score a sweep's solutions again at reference accuracy",
    __doc__,
    _run,
    FINISHED_SWEEP_HELP,
    *RUNNER_ARGUMENT,
    resumes=True,
)
