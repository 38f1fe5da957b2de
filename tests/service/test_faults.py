"""Any fault in the middle of a sweep: every task exactly once, and the bytes of the undisturbed run.

A round is a fault, its moment and its victim, all selected by the round's number. The default is four rounds, each with
another fault; SHIFT3D_FAULT_ROUNDS=50 runs as many, with and without Ray.
"""

from __future__ import annotations

import os
import random

import pandas as pd
import pytest
from drivers import Drivers
from faults import FAULTS, TASKS, Round

from shift3d.cli.main import main

ROUNDS = int(os.environ.get("SHIFT3D_FAULT_ROUNDS", "4"))


def make_round(number: int, drivers: Drivers) -> Round:
    chance = random.Random(f"round {number}")
    _, where = FAULTS[number % len(FAULTS)]
    # A fault's first round runs without Ray if possible, which saves seconds.
    ray = where == "ray" or (number >= len(FAULTS) and chance.random() < 0.5)
    return Round(drivers, chance, ray)


@pytest.mark.parametrize("number", range(ROUNDS), ids=lambda n: f"{n}-{FAULTS[n % len(FAULTS)][0].__name__}")
def test_a_disturbed_sweep_ends_as_an_undisturbed_one(
    number: int, drivers: Drivers, undisturbed: dict[str, bytes]
) -> None:
    here = make_round(number, drivers)
    code = FAULTS[number % len(FAULTS)][0](here)
    if number % 2:
        here.ray = False  # resumed by another runner
    if code is None:
        code = here.succeeds()
    if code == 3:
        _what_was_given_up_on_is_one_task_and_says_why(here)
        code, errors = here.run("--retry-quarantined")
        assert code == 0, errors
    committed = drivers.committed("out")
    assert len(committed) == len(set(committed)) == TASKS
    assert drivers.final("out") == undisturbed
    _no_orphan(here)


def _what_was_given_up_on_is_one_task_and_says_why(here: Round) -> None:
    attempts = pd.read_parquet(here.out / "final" / "attempts.parquet")
    abandoned = attempts[attempts["quarantined"]]
    assert abandoned["task_id"].nunique() == 1
    assert f"--task {abandoned['task_id'].iloc[0]}" in abandoned["traceback"].iloc[0]
    assert set(attempts.loc[attempts["outcome"] == "done", "task_id"]).isdisjoint(abandoned["task_id"])
    committed = here.drivers.committed("out")
    assert len(committed) == len(set(committed)) == TASKS - 1


def _no_orphan(here: Round) -> None:
    """Check that after gc data/ holds only files that the log names, and that the sweep is as complete as before."""
    assert main(["gc", str(here.out)]) == 0
    assert {path.name for path in (here.out / "data").iterdir()} == here.drivers.segments("out")
    assert not list((here.out / "_log").glob(".tmp-*"))
