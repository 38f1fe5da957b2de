"""Counts of the comparison with an earlier commit, and its refusals."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from analytic_fields import sector_scan
from safetensors.torch import save_file
from scripts import comparator

from shift3d.detectors.models.weights import WEIGHTS_FOLDER, load_network
from shift3d.render import Beams, preset, render
from shift3d.sdf.decoder import load_decoder
from shift3d.vehicles.vehicle import baseline_vehicles


def test_hits_of_a_replayed_attack_are_held_against_the_truth(tmp_path: Path) -> None:
    vehicle, (points, origin) = (
        baseline_vehicles()["coupe"],
        sector_scan((13.0, 2.0, -1.0), half_angle_rad=0.17, rays=24),
    )
    beams, code = Beams.from_arrays(points, origin), torch.from_numpy(vehicle.latent_code)
    poses = torch.tensor([[13.0, 2.0, -1.0, yaw, 0.0, 0.0] for yaw in (0.8, 0.81, 0.82)], dtype=torch.float64)
    field = load_decoder().double().field(code.double())
    with torch.no_grad():
        true = [render(beams, field, pose, vehicle, preset("reference")) for pose in poses]
    range_m = torch.stack([torch.where(one.hit_mask, one.range_m, torch.nan) for one in true])
    hits = int((~range_m.isnan()).sum())
    moved = torch.nonzero(~range_m[0].isnan())[:7, 0]
    range_m[0, moved] += 0.02  # seven hits that no renderer finds at the stated place
    parts = {
        "points": beams.points, "origins": beams.origins, "codes": code.repeat(3, 1),
        "poses": poses, "range_m": range_m,
        "scale_m": torch.tensor(float(vehicle.scale_m)).double(),
        "sdf_R_object": torch.as_tensor(np.asarray(vehicle.sdf_R_object, dtype=np.float64)),
        "sdf_t_object": torch.as_tensor(np.asarray(vehicle.sdf_t_object, dtype=np.float64)),
        "size_m": torch.tensor(vehicle.size_m, dtype=torch.float64),
    }  # fmt: skip
    for mode in ("shape", "pose"):
        of_its_own = {key: part.clone().contiguous() for key, part in parts.items()}
        save_file(of_its_own, tmp_path / f"coupe, {mode}.safetensors")
    comparator.replay(tmp_path, tmp_path / "found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    assert list(found) == ["coupe, pose, warm", "coupe, shape, warm", "coupe, shape, cold, no grid"]
    for one in found.values():
        assert one["hits"] == hits > 250 and one["lost"] == 7 and len(one["milliseconds"]) == 2


def test_a_ratio_is_of_the_medians_of_all_turns() -> None:
    def turn(*milliseconds: float, lost: int) -> dict[str, dict[str, object]]:
        return {"suv": {"milliseconds": milliseconds, "lost": lost, "hits": 100}}

    before = [turn(4.0, 6.0, 90.0, lost=2), turn(10.0, 10.0, 10.0, lost=2)]
    after = [turn(3.0, 3.0, 3.0, lost=0), turn(5.0, 1.0, 5.0, lost=0)]
    found = {name: value for name, value, _ in comparator.figures({"before": before, "after": after})}
    assert found["suv/before 1"] == 6.0 and found["suv/after 2"] == 5.0 and found["suv/ratio"] == 2.0
    assert (found["suv/lost before"], found["suv/lost after"], found["suv/hits"]) == (2, 0, 100)


def test_a_commit_with_another_decoder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = tmp_path / "shift3d/weights/sdf.safetensors"
    weights.parent.mkdir(parents=True)
    weights.write_bytes(b"one")
    for words in (["init", "-q"], ["add", "."], ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "a"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    monkeypatch.setattr(comparator, "HERE", tmp_path)
    assert (comparator.earlier_tree("HEAD", tmp_path / "same") / weights.relative_to(tmp_path)).read_bytes() == b"one"
    weights.write_bytes(b"other")
    with pytest.raises(SystemExit, match=r"sdf\.safetensors, is not this version's"):
        comparator.earlier_tree("HEAD", tmp_path / "before")


def test_both_versions_run_tasks_with_the_earlier_detector(tmp_path: Path) -> None:
    file = tmp_path / "shift3d/weights/pointpillars.safetensors"
    file.parent.mkdir(parents=True)
    shipped = load_network(WEIGHTS_FOLDER / file.name).state_dict()
    earlier = {name: value + 1 for name, value in shipped.items() if name != "heads.anchor_size_m"}
    save_file(earlier, file)
    loaded = load_network(comparator.earlier_detector(tmp_path, tmp_path / "both")).state_dict()
    assert all(torch.equal(loaded[name], value) for name, value in earlier.items())
    assert loaded["heads.anchor_size_m"].tolist() == pytest.approx([4.73, 2.08, 1.77])
