"""A machine that cannot run a sweep's tasks is left out while others can; the sweep ends if none can."""

from __future__ import annotations

import dataclasses
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import valid_sweeps
from ray import exceptions
from ray.core.generated.common_pb2 import ActorDiedErrorContext

from shift3d.errors import InputError
from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.sweep.execution.ray import runner as runner_module
from shift3d.sweep.execution.ray import worker as worker_module
from shift3d.sweep.execution.ray.excluded_machines import MAX_UNREADABLE_SCENES, ExcludedMachines
from shift3d.sweep.execution.ray.runner import RayRunner
from shift3d.sweep.execution.ray.versions import installed_versions, version_mismatch
from shift3d.sweep.execution.ray.worker import WorkerAddress
from shift3d.sweep.execution.worker import BatchOutcome
from shift3d.sweep.planning.kind import shift3d_kind
from shift3d.sweep.planning.plan import Plan, make_plan
from shift3d.task.exchange import AssetsSpec

DIED = "The actor died.\n  File x.py, line 1\nImportError: no module named shift3d"
EIO = "OSError: [Errno 5] Input/output error: '/data/frame'"
UNMOUNTED = InputError("no such folder", "/data", "Mount it")


class Ray:
    """Cluster of single-worker machines, by letters. mounted: can load. starting: can start workers; None: all."""

    exceptions = exceptions

    def __init__(self, machines: str, mounted: str, starting: str | None = None) -> None:
        self._machines = machines
        self._mounted = mounted
        self._starting = machines if starting is None else starting
        self._actors: dict[str, Any] = {}
        self.other: dict[str, dict[str, str]] = {}
        self.processors: dict[str, str] = {}
        self._results: dict[Any, Any] = {}
        self.broken = ""
        self.ids: list[str] = []
        self.ran: list[tuple[str, int]] = []
        state = SimpleNamespace(actors=lambda actor: {"Address": {"NodeID": actor}})
        self._private = SimpleNamespace(state=state)

    def nodes(self) -> list[dict[str, Any]]:
        resources = {"CPU": 1, "memory": 2**36}
        named = ({"NodeID": name, "NodeManagerHostname": f"host-{name}"} for name in self._machines)
        return [{"Alive": True, "Resources": resources, **node} for node in named]

    def remote(self, **options: Any) -> Any:
        return lambda _: SimpleNamespace(remote=self._start, options=self._elsewhere)

    def _elsewhere(self, label_selector: dict[str, str]) -> Any:
        return SimpleNamespace(remote=lambda *given: self._start(*given, without=label_selector["ray.io/node-id"]))

    def put(self, value: object) -> object:
        return value

    def actor(self, machine: str) -> Any:
        return SimpleNamespace(
            _actor_id=SimpleNamespace(hex=lambda: machine),
            ready=SimpleNamespace(remote=lambda: self._answer(self._ready(machine))),
            run=SimpleNamespace(remote=lambda positions, attempt: self._answer(self._run(machine, positions))),
        )

    def _start(self, *given: Any, without: str = "") -> Any:
        free = [name for name in self._machines if name not in self._actors and name not in without]
        actor = self.actor(free[0]) if free else SimpleNamespace(ready=SimpleNamespace(remote=object))
        if free and free[0] in self._starting:
            self._actors[free[0]] = actor
        return actor

    def _answer(self, value: Any) -> Any:
        reference = object()
        self._results[reference] = value
        return reference

    def _ready(self, machine: str) -> Any:
        if machine in self._starting:
            versions = {**installed_versions(), **self.other.get(machine, {})}
            return WorkerAddress(machine, f"host-{machine}:1", 1, "", versions, self.processors.get(machine, "AVX2"))
        return exceptions.ActorDiedError(ActorDiedErrorContext(error_message=DIED, actor_id=b"0" * 16))

    def _run(self, machine: str, positions: list[int]) -> BatchOutcome:
        if machine not in self._mounted:
            return BatchOutcome(fatal=UNMOUNTED)
        self.ran += [(machine, position) for position in positions]
        if machine in self.broken:
            ids = [self.ids[position] for position in positions]
            # Each file is tried four times, with pauses.
            return BatchOutcome(quarantined=ids, unread=ids, errors=[EIO] * len(ids), seconds=10.5 * len(ids))
        return BatchOutcome(done=[str(position) for position in positions])

    def wait(self, references: list[Any], timeout: float, num_returns: int = 1) -> tuple[list[Any], list[Any]]:
        """Return finished references, starts before calls."""
        ready = [reference for reference in reversed(references) if reference in self._results][:num_returns]
        return ready, [reference for reference in references if reference not in ready]

    def get(self, reference: Any) -> Any:
        if isinstance(result := self._results.pop(reference), Exception):
            raise result
        return result

    def kill(self, actor: Any) -> None:
        self._actors = {name: other for name, other in self._actors.items() if other is not actor}


def outcomes(
    ray: Ray, monkeypatch: pytest.MonkeyPatch, plan: Plan | None = None
) -> tuple[list[BatchOutcome], RayRunner]:
    monkeypatch.setattr(runner_module, "connect", lambda config, left: ray)
    config = validate(compose_sweep("smoke", ["runner.address=auto"]).base, "test").runner
    assert isinstance(config, RayRunnerConfig)
    plan = plan or valid_sweeps.plan()
    ray.ids = plan.tasks.ids.to_pylist()
    runner = RayRunner(shift3d_kind(), plan, config, len(plan.tasks))
    return list(runner.run(np.arange(len(plan.tasks)), threading.Event())), runner


def plan_of_scenes(count: int) -> Plan:
    """Plan one task per scene."""
    scenes = tuple(SceneEntry(name, "street-hdl64", name, SceneFacts(name)) for name in map(str, range(count)))
    composed = compose_sweep("smoke", ["vehicle=suv", "mode=shape"])
    return make_plan(composed, lambda config: dataclasses.replace(valid_sweeps.catalogue(config), scenes=scenes))[0]


def test_others_run_the_tasks_of_a_machine_that_cannot_load(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ray = Ray("ab", mounted="b")
    found, runner = outcomes(ray, monkeypatch)
    assert sorted(ray.ran) == [("b", 0), ("b", 1)]
    assert not any(outcome.fatal or outcome.quarantined for outcome in found)
    line = "host-a is left out: /data: no such folder. Mount it"
    assert list(runner.left_out) == [line] and capsys.readouterr().err.splitlines() == [line]
    tables = [outcome.tables["attempts"] for outcome in found if outcome.tables]
    assert [(row["outcome"], row["error"]) for table in tables for row in table.to_pylist()] == [("not_loaded", line)]


def test_where_no_machine_can_load_the_sweep_ends_with_the_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found, _ = outcomes(Ray("ab", mounted=""), monkeypatch)
    assert [str(outcome.fatal) for outcome in found if outcome.fatal] == [str(UNMOUNTED)]
    assert found[-1].fatal and capsys.readouterr().err == "", "the error says it"


def test_a_machine_where_no_worker_starts_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ray = Ray("ab", mounted="ab", starting="b")
    found, runner = outcomes(ray, monkeypatch)
    assert {machine for machine, _ in ray.ran} == {"b"} and not any(outcome.fatal for outcome in found)
    (line,) = runner.left_out
    why = "no worker starts there: ImportError: no module named shift3d. Install this shift3d on every machine"
    assert line == f"host-a is left out: {why}"


def test_where_no_worker_starts_anywhere_the_sweep_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = outcomes(Ray("ab", mounted="ab", starting=""), monkeypatch)
    assert "no worker starts" in str(found[-1].fatal)


def test_a_machine_whose_files_fail_scene_after_scene_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = Ray("abc", mounted="abc")
    ray.broken = "a"
    found, runner = outcomes(ray, monkeypatch, plan_of_scenes(40))
    failed = [name for outcome in found for name in outcome.quarantined]
    assert (
        len(failed) == MAX_UNREADABLE_SCENES
        and sum(len(outcome.done) for outcome in found) == 40 - MAX_UNREADABLE_SCENES
    )
    (line,) = runner.left_out
    assert line.startswith("host-a is left out: tasks of 3 scenes in a row failed there: " + EIO)
    assert not any(outcome.fatal for outcome in found)


def test_where_the_files_of_every_machine_fail_the_last_one_is_not_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = Ray("ab", mounted="ab")
    ray.broken = "ab"
    found, runner = outcomes(ray, monkeypatch, plan_of_scenes(12))
    assert len(runner.left_out) == 1 and sum(len(outcome.quarantined) for outcome in found) == 12


def test_damaged_scenes_here_and_there_leave_no_machine_out() -> None:
    left_out = ExcludedMachines(Ray("ab", mounted="ab"), 1.0)
    assert not any(left_out.unread("a", {scene}, done=False) for scene in ("1", "1", "2", "1"))
    assert not left_out.unread("a", set(), done=True) and not left_out.unread("a", {"3", "4"}, done=False)
    assert left_out.unread("a", {"5"}, done=False)


def test_whatever_fails_while_assets_are_loaded_is_the_machines_defect() -> None:
    def load(_: AssetsSpec) -> object:
        raise ImportError("libtorch.so: file too short")

    with pytest.raises(InputError, match=r"test_excluded_machines.py:\d+: .* ImportError: libtorch.so: file too short"):
        worker_module._load(load, AssetsSpec({"kind": "street"}), {})


def test_a_machine_with_other_versions_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = Ray("ab", mounted="ab")
    ray.other["a"] = {"torch": "1.0"}
    found, runner = outcomes(ray, monkeypatch)
    assert {machine for machine, _ in ray.ran} == {"b"} and not any(outcome.fatal for outcome in found)
    assert runner.left_out[0].startswith(
        f"host-a is left out: has torch 1.0, not {installed_versions()['torch']} as the driver."
    )
    ray = Ray("a", mounted="a")
    ray.other["a"] = {"torch": "1.0"}
    found, _ = outcomes(ray, monkeypatch)
    assert str(found[-1].fatal).startswith("host-a: has torch 1.0, not ") and not ray.ran


def test_a_mix_of_processors_is_named_once(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    ray = Ray("abc", mounted="abc")
    ray.processors = {"b": "AVX512", "c": "AVX512"}
    found, runner = outcomes(ray, monkeypatch, plan_of_scenes(12))
    assert sum(len(outcome.done) for outcome in found) == 12 and not runner.left_out, "no machine is left out for it"
    (line,) = capsys.readouterr().err.splitlines()
    assert {"AVX2", "AVX512"} <= set(line.replace(",", " ").replace(":", " ").split()) and "one kind" in line


def test_processors_of_one_kind_need_no_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outcomes(Ray("ab", mounted="ab"), monkeypatch)
    assert capsys.readouterr().err == ""


def test_another_build_is_another_version_and_a_source_tree_is_compared_with_none() -> None:
    here = {"shift3d": "1", "code": "abcd"}
    assert version_mismatch(here, here) is None and version_mismatch({**here, "code": ""}, here) is None
    assert "another build of shift3d: 1234, not abcd" in str(version_mismatch({**here, "code": "1234"}, here))


def test_onnx_runtimes_are_compared_where_both_machines_have_one() -> None:
    here = {"torch": "2", "onnxruntime": "1.27.0"}
    assert "has onnxruntime 1.20.0, not 1.27.0" in str(version_mismatch({**here, "onnxruntime": "1.20.0"}, here))
    without = {**here, "onnxruntime": "absent"}
    assert version_mismatch(without, here) is None and version_mismatch(here, without) is None
