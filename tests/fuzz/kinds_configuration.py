"""Mutants of sweep files, command-line overrides, and plain settings, through Hydra and the schema.

Hydra takes a third of a second to compose the repository's own files. The sweep file of these tests therefore holds
every setting itself, in an installation of its own: a folder with sweeps/ and conf/, which has only two groups.
"""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import yaml
from feeding import InputKind, register
from mutations import WORDS, Rng, mutate_text, pick
from valid_settings import installed, settings, write_installation
from value_mutations import ODD_VALUES, mutate_values

from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.compose import ComposedSweep, compose_sweep
from shift3d.settings.expand import expand
from shift3d.settings.schema.config import Config

OVERRIDES = (
    *("attack.steps=7", "attack.lambda=0.1,10", "scenes.count=2", "vehicle=suv", "vehicle=coupe,suv", "mode=pose"),
    *("accuracy.render.step_m=0.05", "accuracy.name=draft,paper", "attack.placement.max_range_m=range(20,50,10)"),
    *("scene='street a','street b'", "detector.scored_by=[pointpillars,sst]", "seed=3", "scenes.sensor=hdl64"),
)


def check(config: Config) -> dict[str, Any]:
    """Check plain values: no NaN or infinity, as a task's id needs, and settings that the renderer accepts."""
    render = accuracy_settings(config.accuracy)
    values = config.settings()
    json.dumps([values, render], sort_keys=True, allow_nan=False)
    numbers = [v for v in render.values() if isinstance(v, float)]
    assert all(math.isfinite(value) and value >= 0.0 for value in numbers)
    assert 0.0 < config.attack.alpha < 1e12 and config.attack.steps >= 0
    assert 0.0 <= config.attack.placement.min_range_m < config.attack.placement.max_range_m < 1e12
    assert config.scenes.count is None or 1 <= config.scenes.count <= 10**6
    return values


def load_sweep(folder: Path) -> Any:
    words = shlex.split((folder / "words").read_text()) if (folder / "words").read_text() else []
    with installed(folder):
        return [check(config) for config in expand(compose_sweep("mine", words))]


def mutate_sweep(folder: Path, rng: Rng) -> str:
    path = folder / str(pick(("sweeps/mine.yaml",) * 4 + ("conf/vehicle/suv.yaml", "conf/attack/paper.yaml"), rng))
    how = pick(("text", "values", "values", "harmless", "interpolation", "foreign"), rng)
    values = yaml.safe_load(path.read_text())
    if how == "text":
        path.write_bytes(mutate_text(path.read_bytes(), rng))
        return "text"
    if how == "harmless":
        path.write_text("# by hand\n\n" + yaml.safe_dump(values, sort_keys=True, default_flow_style=True))
        return "harmless"
    if how == "interpolation":
        loop = pick(("${mode}", "${scene}", "${a.b}", "${oc.env:HOME}", "${seed", "${hydra:sweeper}", "${..x}"), rng)
        values[pick(sorted(values), rng)] = loop
    elif how == "foreign":
        values[pick(("_target_", "hydra/launcher", "_partial_", "package", "defaults"), rng)] = pick(ODD_VALUES, rng)
    else:
        values = mutate_values(values, rng)
    path.write_text(yaml.dump(values, sort_keys=False))
    return str(how)


def mutate_words(folder: Path, rng: Rng) -> str:
    word = str(pick(OVERRIDES, rng))
    how = pick(("value", "text", "text", "prefix", "none"), rng)
    if how == "value":
        word = f"{word.partition('=')[0]}={pick(WORDS, rng)}"
    elif how == "text":
        word = mutate_text(word.encode(), rng).decode(errors="replace")
    elif how == "prefix":
        word = str(pick(("+", "++", "~", "-", "hydra.", "a.", "@", "attack."), rng)) + word
    (folder / "words").write_text(shlex.join([word, str(pick(OVERRIDES, rng))]))
    return f"override {word!r}"


def write_values(folder: Path) -> None:
    (folder / "values.json").write_text(json.dumps(settings()))


def mutate_plain(folder: Path, rng: Rng) -> str:
    path = folder / "values.json"
    path.write_text(json.dumps(mutate_values(json.loads(path.read_text()), rng)))
    return "values"


def load_values(folder: Path) -> Any:
    values = json.loads((folder / "values.json").read_text())
    (config,) = expand(ComposedSweep("mine", (), values, ()))
    return check(config)


SWEEP = ("sweep mine", "accuracy.", "render settings")
register(InputKind("settings", 300, write_values, mutate_plain, load_values, SWEEP))
register(InputKind("sweep file", 45, write_installation, mutate_sweep, load_sweep, SWEEP))
register(InputKind("overrides", 45, write_installation, mutate_words, load_sweep, SWEEP))
