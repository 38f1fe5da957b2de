"""The same bytes from every runner."""

from __future__ import annotations

from pathlib import Path

import pytest
from drivers import Drivers

from shift3d.sweep.planning.folder import read_plan


def test_an_unknown_name_is_one_line(drivers: Drivers) -> None:
    code, output, errors = drivers.run("out", "runner=local", "vehicle=sub")
    assert code == 2, (output, errors)
    assert "Did you mean 'suv'?" in errors and len(errors.strip().splitlines()) == 1
    assert not (drivers.folder / "out").exists()


def test_one_task_of_a_plan_is_shown_and_nothing_is_written(drivers: Drivers, undisturbed_folder: Path) -> None:
    task = next(task.spec.task_id for task in read_plan(undisturbed_folder).tasks if task.spec.mode == "shape")
    code, output, errors = drivers.run("out", "runner=local", "--task", task[:12])
    assert code == 0, errors
    assert "adversarial_noise" in output and "milliseconds" in output
    assert not (drivers.folder / "out").exists()
    code, _, errors = drivers.run("out", "runner=local", "--task", "nothing")
    assert code == 2 and "0 tasks with an id that begins with 'nothing'" in errors
    with pytest.raises(ArithmeticError, match="no root"):  # a defect shows its traceback
        drivers.run("out", "--task", task, SHIFT3D_TEST_FAILS="coupe/street_000/shape")
