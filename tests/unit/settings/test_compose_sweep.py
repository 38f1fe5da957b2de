"""Sweeps are composed once and expand to the jobs of Hydra's own multirun, in its order."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from shift3d.errors import InputError
from shift3d.render.settings import RenderSettings
from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.expand import expand
from shift3d.settings.folders import files, shipped

ONE = ["vehicle=suv", "mode=shape", "attack.lambda=1"]  # the sweep file's own axes, each at one value
SWEEPS = [
    ["vehicle=suv,coupe"],
    ["mode=pose", "attack.lambda=0.1,10", "vehicle=suv"],
    [*ONE, "attack.steps=range(10,30,10)", "accuracy=draft,paper"],
    [*ONE, "accuracy.render.step_m=0.05,0.1", "accuracy=draft,paper", "scenes.sensor=hdl64"],
    ["vehicle=glob(c*)", "mode=pose", "attack.lambda=1"],
    [*ONE, "scene='street a','street b'"],
    # Groups that are axes together with settings of their options, whichever is named first.
    [*ONE, "attack=short,paper", "attack.steps=3,4"],
    ["vehicle=suv", "mode=pose", "attack.lambda=1", "effects=none,auto", "replicate=range(2)"],
    # Ranges: a step, none, downwards, of floats; choices named as such, with a name, sorted and shuffled in the file.
    [*ONE, "seed=range(0,6,3)", "attack.alpha=range(0.1,0.3,0.1)"],
    [*ONE, "seed=range(start=5,stop=1,step=-2)", "replicate=choice(2,1)"],
    [*ONE, "seed=sort(3,1)", "attack.alpha=sort(0.1,0.3,reverse=true)"],
    # Choices of lists and of mappings, of texts with commas, of null.
    [*ONE, "detector.scored_by=[pointpillars],[pointpillars,sst],null"],
    [*ONE, "detector.scored_by=choice([sst],[])", "scene=null,north"],
    [*ONE, "scene='a,b',\"c d\""],
    # Globs of options, with some left out.
    ["vehicle=glob([c*,s*],exclude=[set,sports*])", "mode=pose", "attack.lambda=1"],
]


def hydra_multirun(name: str, overrides: list[str]) -> list[dict[str, Any]]:
    """Return every job's settings from Hydra's multirun: its sweeper's split, then one composition per job."""
    search = f"hydra.searchpath=[file://{shipped('conf')}]"
    with initialize_config_dir(config_dir=str(shipped("sweeps")), version_base=None):
        first = compose(name, overrides=[search], return_hydra_config=True)
        params = [f"{key}={value}" for key, value in first.hydra.sweeper.params.items()]
        # compose() alone knows no options of groups on the search path, which glob() needs.
        loader = GlobalHydra.instance().config_loader()
        loader.get_group_options = lambda group, *_, **__: sorted(
            p.stem for p in (shipped("conf") / group).glob("*.yaml")
        )
        parsed = OverridesParser.create(config_loader=loader).parse_overrides([*params, *overrides])
        jobs = BasicSweeper.split_arguments(parsed, None)[0]
        configs = [compose(name, overrides=[search, *job]) for job in jobs]
    return [OmegaConf.to_container(config) for config in configs]  # type: ignore[misc]


@pytest.mark.parametrize("overrides", SWEEPS, ids=lambda words: " ".join(words) or "none")
def test_same_tasks_in_the_same_order_as_hydras_multirun(overrides: list[str]) -> None:
    ours = list(expand(compose_sweep("default", overrides)))
    theirs = [validate(settings, "hydra") for settings in hydra_multirun("default", overrides)]
    assert ours == theirs
    assert len(ours) > 1


def test_an_override_wins_over_the_option_that_it_belongs_to() -> None:
    configs = list(
        expand(compose_sweep("default", ["attack=short,paper", "attack.steps=7", "vehicle=suv", "mode=shape"]))
    )
    assert {config.attack.steps for config in configs} == {7}
    assert {config.attack.noise_replicates for config in configs} == {2, 10}


@pytest.mark.parametrize("plus", ["+", "++"])
def test_an_added_setting_can_be_an_axis(plus: str) -> None:
    key = "detector.other_weights.openpcdet"
    added = ["detector.scored_by=[openpcdet]", "+detector.config=file", f"{plus}{key}=a,b"]
    composed = compose_sweep("default", [*ONE, *added])
    assert composed.axes[-1].key == key
    assert [config.detector.other_weights["openpcdet"] for config in expand(composed)] == ["a", "b"]
    (config,) = expand(compose_sweep("default", [*ONE, *added, f"{key}=c"]))
    assert config.detector.other_weights["openpcdet"] == "c"


def test_a_later_override_with_plus_signs_replaces_an_axis() -> None:
    for last, values in (("3", {3}), ("3,4", {3, 4})):
        configs = expand(compose_sweep("default", [*ONE, "attack.lambda=1,2", f"++attack.lambda={last}"]))
        assert {config.attack.lambda_ for config in configs} == values


# accuracy_time is measured by `shift3d frontier`, see test_frontier_config.
@pytest.mark.parametrize("name", [name for name in files("sweeps") if name != "accuracy_time"])
def test_every_sweep_is_valid(name: str) -> None:
    overrides = ["scenes.root=somewhere"] if name == "kitti" else []
    assert list(expand(compose_sweep(name, overrides)))


def test_cars_of_an_experiment_take_the_place_of_the_sweeps_own() -> None:
    words = ["scenes.root=somewhere", "vehicle=deepsdf", "vehicle.folder=there", "vehicle.name=van_1,suv_2"]
    configs = list(expand(compose_sweep("kitti", [*words, "vehicle.length_m={default:4.5,van:4.9}"])))
    assert {(config.vehicle.kind, config.vehicle.name) for config in configs} == {
        ("deepsdf", "van_1"),
        ("deepsdf", "suv_2"),
    }
    assert len(configs) == 2 * 2 * 2
    assert configs[0].settings()["vehicle"]["length_m"] == {"default": 4.5, "van": 4.9}


def test_a_sweep_of_sst_is_one_override() -> None:
    pointpillars, sst = (list(expand(compose_sweep("default", words))) for words in ([], ["detector=sst"]))
    assert len(pointpillars) == len(sst)
    assert {config.detector.name for config in sst} == {"sst"}


def test_accuracy_lists_every_setting_of_the_renderer() -> None:
    configs = list(expand(compose_sweep("smoke", ["vehicle=suv", "mode=shape"])))
    assert set(configs[0].accuracy.render) == {field.name for field in dataclasses.fields(RenderSettings)}


def test_every_option_of_every_group_is_valid() -> None:
    """Each composition takes the next option of every group."""
    folders = [path for path in shipped("conf").iterdir() if path.is_dir() and path.name != "size"]  # see test_sizes
    groups = {folder.name: sorted(path.stem for path in folder.glob("[!_]*.yaml")) for folder in sorted(folders)}
    assert all(groups.values())
    for turn in range(max(map(len, groups.values()))):
        chosen = {group: options[turn % len(options)] for group, options in groups.items()}
        base = compose_sweep("smoke", ["mode=shape", *(f"{group}={option}" for group, option in chosen.items())]).base
        for group in groups:
            known = {key: "somewhere" for key, default in base[group].items() if default == "???"}
            base[group] = {**base[group], **known}
        validate(base, f"options {chosen}")


def test_configuration_names_no_code() -> None:
    files = [*shipped("conf").rglob("*.yaml"), *shipped("sweeps").glob("*.yaml")]
    assert files
    for path in files:
        assert not re.search(r"_target_|_partial_|!!python|\beval\b", path.read_text()), path


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["vehicle=sub"], "unknown vehicle 'sub'. Did you mean 'suv'? One of: beach_wagon"),
        (["scenes.cout=3"], "unknown setting 'scenes.cout'. Did you mean 'scenes.count'?"),
        (
            ["scenes.root=x"],
            "scenes.root is a setting of another option of scenes than the chosen one. Choose one that has "
            "it: scenes=argoverse2, scenes=kitti, scenes=nuscenes",
        ),
        (["sceness.count=3"], "unknown setting 'sceness.count'"),
        (["attack.alpha=interval(0,1)"], "continuous axis"),
        (["attack.alpha=shuffle(0.01,0.02)"], "shuffled axis"),
        (["attack.alpha=shuffle(range(1,4))"], "shuffled axis"),
        (["scenes=kitti,street"], "Add scenes.root=VALUE to a sweep of this option of scenes alone"),
        (["attack.alpha="], "attack.alpha= is empty. Give attack.alpha=..., or no attack.alpha= at all"),
        (["detector.weights="], "detector.weights= is empty"),
        (["+seed= "], "+seed= is empty"),
        (["vehicle=suv", "a b=(c"], "cannot read the override 'a b=(c'"),
        (["effects={fog}"], "cannot read the override 'effects={fog}'"),
        (["scenes.count=[1"], "cannot read the override 'scenes.count=[1'"),
        (["vehicle=suv,"], "cannot read the override 'vehicle=suv,'"),
        (["word"], "cannot read the override 'word'"),
        (["=3"], "no setting is named"),
        (
            ["vehicle=[coupe,suv]"],
            "vehicle takes one option, and the last would win. Write several as an axis: vehicle=coupe,suv",
        ),
        (["accuracy=[draft,reference]"], "Write several as an axis: accuracy=draft,reference"),
        (["mode=shape_pose", "attack.search_scenes=2"], "attack.search_scenes and transfer_scenes are of mode=shape"),
        (["effects=[fogg]"], "unknown effects 'fogg'. Did you mean 'fog'? One of: auto, "),
        (["effects=[fog,rian]"], "unknown effects 'rian'. Did you mean 'rain'?"),
        (["scenes=[streeet]"], "unknown scenes 'streeet'. Did you mean 'street'? One of: argoverse2, "),
        (["effects=[fog,3]"], "unknown effects '3'. One of: auto"),
        (["effects=null"], "unknown effects 'null'. One of: auto"),
        (["scenes.sensor=hdl65"], "Did you mean 'hdl64'? One of: hdl64, waymo_top, mixed"),
        (["scenes.returns=3"], "unknown scenes.returns '3'. One of: 1, 2"),
        (["attack.detection_radius_m=8"], "attack.detection_radius_m is 8: input should be less than or equal to 5"),
        (["attack.noise_share=5"], "attack.noise_share is 5: input should be less than or equal to 1"),
        (
            ["attack.naturalness=0.95"],
            "naturalness is 0.95, and a percentile goes from 1 to 100. Give attack.naturalness=95,",
        ),
        (["attack.steps=-1"], "attack.steps is -1: input should be greater than or equal to 0"),
        (["attack.steps=many"], "attack.steps is 'many': input should be a valid integer"),
        (["attack.steps=2.5"], "attack.steps is 2.5"),
        (["attack.alpha=nan"], "attack.alpha is nan: input should be a finite number"),
        (["mode=shap,pose"], "unknown mode 'shap'. Did you mean 'shape'?"),
        (["accuracy=standart"], "Did you mean 'standard'?"),
        (["runner.workers=1,2"], "cannot be an axis"),
        (["runner.cpus_per_worker=0.00001"], "input should be greater than or equal to 0.0001"),
        (["runner=rey"], "Did you mean 'ray'?"),
        (["scenes=kitti"], "scenes.root is required. Add scenes.root=VALUE"),
        (["vehicle=deepsdf", "vehicle.name=a"], "vehicle.folder is required. Add vehicle.folder=VALUE"),
        (
            ["vehicle=deepsdf", "vehicle.name=a", "vehicle.folder=b", "vehicle.length_m=-1"],
            "Change it with vehicle.length_m=VALUE",
        ),
        (["vehicle=suv", "accuracy.render.solver=[a]"], "Change it with accuracy.render.solver=VALUE"),
        (
            ["vehicle=suv", "mode=shape", "attack.search=expectation", "attack.placements=4", "attack.steps=3"],
            "leave nothing of 3 steps. Give attack.steps=4 or more, or a smaller attack.starts",
        ),
        (["detector=ssd"], "Did you mean 'sst'?"),
        (["detector.scored_by=[ssd]"], "Did you mean 'sst'?"),
        (["accuracy.render={step:0.05}"], "accuracy.render cannot be set as a whole"),
        (["attack.placement=3"], "attack.placement cannot be set as a whole"),
        (
            ["scenes=kitti", "scenes.root=a", "scenes.sensor=hdl64"],
            "scenes.sensor is a setting of another option of scenes",
        ),
        (
            ["scenes=nuscenes", "scenes.root=a", "scenes.every=2"],
            "scenes.names, scenes.root, scenes.skip_bad, scenes.sweeps, scenes.version",
        ),
        (["~scenes"], "cannot be removed"),
        (["+extra=3"], "there is no setting extra"),
        (["+scenes.extra=3"], "there is no setting scenes.extra"),
        (["scene=${vehicle.name}"], "interpolation"),
        (["vehicle._target_=os.system"], "unknown setting 'vehicle._target_'"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_bad_settings_are_one_line_with_a_remedy(overrides: list[str], message: str) -> None:
    with pytest.raises(InputError) as failure:
        list(expand(compose_sweep("default", ["vehicle=suv", *overrides])))  # one of five: an axis is composed by value
    assert message in str(failure.value)
    assert "\n" not in str(failure.value)
    assert failure.value.where == "sweep default"
    assert failure.value.remedy


def test_kitti_without_a_folder_says_which_setting_is_missing() -> None:
    with pytest.raises(InputError, match=r"scenes\.root is required"):
        list(expand(compose_sweep("kitti")))


def test_unknown_sweep() -> None:
    with pytest.raises(InputError, match="Did you mean 'kitti'"):
        compose_sweep("kiti")
