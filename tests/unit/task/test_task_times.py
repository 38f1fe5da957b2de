"""A task's times: every search, including that of the comparison, reports its time by stage."""

from __future__ import annotations

from dataclasses import replace

from short_tasks import make_spec

from shift3d.task.assets import Assets
from shift3d.task.run import run_task
from shift3d.task.spec import AttackSpec


def test_the_times_of_the_comparison_stand_beside_those_of_the_search(assets: Assets) -> None:
    attack = AttackSpec(steps=2, search="expectation", placements=2, random_search=1)
    attack = replace(attack, noise_replicates=0, random_replicates=0)
    result = run_task(make_spec(attack=attack), assets)
    spent = {(row["method"], row["stage"]): row for row in result.timings}
    # The baseline and one step of the search, each at two places; no descent starts from the draws.
    assert spent["adversarial", "backward"]["milliseconds"] > 0.0
    assert spent["random_budget", "render"]["calls"] == 1 + 2 + 1  # baseline, draws, and the winner's own score
    assert ("random_budget", "backward") not in spent
    stages = sum(row["milliseconds"] for (_, stage), row in spent.items() if stage != "total")
    assert 0.0 < stages <= spent["adversarial", "total"]["milliseconds"]
