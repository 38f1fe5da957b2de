"""Weight files: refusals, and that saving and loading changes nothing."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from shift3d.detectors.loading import load_detector
from shift3d.detectors.models.pillar_detectors import PointPillarsNet
from shift3d.detectors.models.weights import NETWORKS, load_network
from shift3d.detectors.names import DETECTOR_NAMES, FOREIGN, ONNX, OWN
from shift3d.errors import InputError
from shift3d.training.detector.recipes import RECIPES


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "pointpillars.safetensors"
    save_file({name: tensor.contiguous() for name, tensor in PointPillarsNet().state_dict().items()}, path)
    return path


def test_round_trip(file: Path) -> None:
    net = load_network(file)
    assert not net.training
    saved = load_file(file)
    assert all(torch.equal(tensor, saved[name]) for name, tensor in net.state_dict().items())


def test_unknown_name() -> None:
    with pytest.raises(InputError, match=r"unknown detector 'pointpilars'.*One of: pointpillars.*own, onnx"):
        load_detector("pointpilars")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        load_detector(path=tmp_path / "none.safetensors")


def test_truncated_file(file: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(InputError, match=r"broken\.safetensors"):
        load_detector(path=broken)


@pytest.mark.parametrize("fault", ["shape", "missing", "surplus", "nan"])
def test_wrong_tensors(file: Path, tmp_path: Path, fault: str) -> None:
    state = load_file(file)
    name = "heads.classes.weight"
    if fault == "shape":
        state[name] = torch.zeros(3, 384, 1, 1)
    elif fault == "missing":
        del state[name]
    elif fault == "surplus":
        state["heads.more.weight"] = torch.zeros(1)
    else:
        state[name][0, 0] = torch.nan
    broken = tmp_path / "broken.safetensors"
    save_file(state, broken)
    message = {
        "shape": r"has shape \(3, 384, 1, 1\), the network has .*Give weights of pointpillars",
        "missing": f"tensor {name} is missing",
        "surplus": r"tensor heads\.more\.weight is in no layer of the network",
        "nan": "finite",
    }[fault]
    with pytest.raises(InputError, match=message):
        load_detector(path=broken)


def test_every_name_has_a_network_a_setting_and_a_recipe() -> None:
    """One list names detectors in settings, commands, weights and recipes."""
    settings = Path(__file__).resolve().parents[3] / "conf" / "detector"
    assert tuple(NETWORKS) == DETECTOR_NAMES
    others = {OWN, ONNX, *FOREIGN}
    assert {file.stem for file in settings.glob("*.yaml")} - others == set(DETECTOR_NAMES) == set(RECIPES)
    assert all(NETWORKS[name]().name == name for name in DETECTOR_NAMES)


def test_a_detector_without_weights_says_in_one_line_how_to_train_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="shift3d train model=centerpoint") as error:
        load_detector("centerpoint", tmp_path / "centerpoint.safetensors")
    assert "\n" not in str(error.value)
