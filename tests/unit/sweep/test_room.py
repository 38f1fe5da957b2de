"""As many workers as fit by CPU and by memory, machine by machine."""

from __future__ import annotations

from typing import Any

from shift3d.sweep.execution.ray.worker_pool import room_for


def node(cpus: float, memory_gb: float, alive: bool = True) -> dict[str, Any]:
    return {"Alive": alive, "Resources": {"CPU": cpus, "memory": memory_gb * 2**30}}


def test_the_scarcer_of_the_two_decides_on_each_machine() -> None:
    assert room_for([node(8, 2), node(2, 64)], cpus=1, memory_mb=1024) == 2 + 2


def test_machines_that_are_gone_hold_none() -> None:
    assert room_for([node(8, 64, alive=False), node(2, 64)], cpus=1, memory_mb=1024) == 2


def test_one_worker_is_tried_where_memory_seems_too_little_for_any() -> None:
    assert room_for([node(4, 0.5), node(4, 0.5)], cpus=1, memory_mb=1024) == 1


def test_no_cpus_no_worker() -> None:
    assert room_for([node(0, 64), node(0.5, 64)], cpus=1, memory_mb=1024) == 0
