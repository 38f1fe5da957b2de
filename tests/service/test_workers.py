"""The same bytes whatever runs the tasks."""

from __future__ import annotations

from drivers import Drivers


def test_workers_change_no_byte(drivers: Drivers, undisturbed: dict[str, bytes]) -> None:
    code, _, errors = drivers.run("out", "runner.workers=3")
    assert code == 0, errors
    assert drivers.final("out") == undisturbed


def test_an_unknown_name_is_one_line(drivers: Drivers) -> None:
    code, output, errors = drivers.run("out", "vehicle=sub")
    assert code == 2, (output, errors)
    assert "Did you mean 'suv'?" in errors and len(errors.strip().splitlines()) == 1
    assert not (drivers.folder / "out").exists()
