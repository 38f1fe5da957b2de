"""Report of a fine-tuning: from scores and evaluations to finetune.parquet, report.html and MLflow."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pyarrow as pa

from shift3d.analysis.mlflow.measurement_runs import mirror_measured
from shift3d.evaluation.breakdown import AveragePrecisionDraws, overall_areas
from shift3d.finetuning.page import finetune_page, gains_table
from shift3d.finetuning.rescoring import RESCORED, attacked_scores, rescore_objects
from shift3d.finetuning.table import ADAPTIVE, TUNED, VANILLA, finetune_table, natural_rows
from shift3d.settings.catalogue.detector_files import file_hash
from shift3d.store.atomic import write_atomic
from shift3d.store.tables import read_parquet, write_table
from shift3d.training.detector.detect_scenes import read_scene_detections

HELD_OUT = ("held_out", "other_vehicles")
"""Folders of sweeps over held-out streets: vanilla's in the fine-tuning's folder, a tuned model's in the model's."""
NATURAL = "natural"
_TABLE, _PAGE = "finetune.parquet", "report.html"
_OBJECT = [name for name in RESCORED.names if name != "score"]


@dataclass(frozen=True)
class TunedModel:
    """One tuned model. folder: holds its weights, its evaluation and, if it is attacked, its own sweeps."""

    model: str
    seed: int
    folder: Path
    detector: str

    @property
    def weights(self) -> Path:
        """File of the weights."""
        return self.folder / f"{self.detector}.safetensors"

    def scores_file(self, sweep: str) -> Path:
        """Return the file of the model's scores of vanilla's objects; the name depends on the weights."""
        return self.folder / f"scores-{sweep}-{file_hash(self.weights)[:12]}.parquet"


def score_held_out(folder: Path, tuned: TunedModel) -> None:
    """Score vanilla's objects of every held-out sweep with a tuned model.

    Stored scores are reused unless the sweep has further objects, as from tasks that were retried.
    Raises: InputError as `rescore_objects`; a file of scores that is damaged.
    """
    for sweep in HELD_OUT:
        file, objects = tuned.scores_file(sweep), attacked_scores(folder / sweep, tuned.detector).select(_OBJECT)
        if not file.is_file() or not _table(file).select(_OBJECT).equals(objects):
            write_table(file, rescore_objects(folder / sweep, tuned.detector, tuned.weights))


def write_report(folder: Path, detector: str, models: Sequence[TunedModel], commands: Sequence[str]) -> str:
    """Write finetune.parquet and report.html atomically. Returns the table to print.

    commands: commands that made the folder, for the page. The same folder gives the same bytes.
    Raises: InputError for a sweep, evaluation or scores that are missing or damaged, or a full disk.
    """
    scores = pd.concat(list(_scores(folder, detector, models)), ignore_index=True)
    folders: dict[Model, Path] = {(VANILLA, None): folder / VANILLA / NATURAL}
    folders |= {(tuned.model, tuned.seed): tuned.folder / NATURAL for tuned in models}
    table = finetune_table(scores, natural_rows(natural_areas(folders)))
    frame = table.to_pandas()
    write_table(folder / _TABLE, table)
    first = next(tuned for tuned in models if tuned.model == TUNED)
    provenance = json.loads(first.weights.with_suffix(".json").read_bytes())
    write_atomic(folder / _PAGE, finetune_page(frame, scores, provenance, commands).encode())
    return f"{gains_table(frame)}\n\n{folder / _TABLE}, {folder / _PAGE}"


Model = tuple[str, int | None]
"""Name and seed of a model; seed None for vanilla, the detector before tuning."""


def natural_areas(folders: Mapping[Model, Path]) -> dict[Model, dict[tuple[str, str], AveragePrecisionDraws]]:
    """Compute AP and APH of models on the natural scenes common to their last evaluations. folders: of evaluations."""
    # A folder may hold more results, from the same command with more streets.
    tables = [_table(own / "timings.parquet") for own in folders.values()]
    shared = sorted(set.intersection(*(set(table["scene"].to_pylist()) for table in tables)))
    return {
        key: overall_areas([read_scene_detections(own / "scenes" / f"{name}.npz").frame for name in shared])
        for key, own in folders.items()
    }


def mirror(folder: Path, models: Sequence[TunedModel], uri: str, experiment: str) -> str | None:
    """Log a fine-tuning to MLflow as a run. Returns None, or why it could not be written."""
    metrics: dict[str, float] = {}
    for row in _table(folder / _TABLE).to_pylist():
        parts = [row["scene_set"], row["objects"], row["metric"], row["model"]]
        parts += [] if row["seed"] is None else [f"seed {row['seed']}"]
        name = "/".join(part for part in parts if part)
        metrics |= {f"{name}/{column}": row[column] for column in ("value", "gain") if row[column] is not None}
    facts = [json.loads(tuned.weights.with_suffix(".json").read_bytes()) for tuned in models]
    params = {f"{tuned.model}-{tuned.seed}": _params(own) for tuned, own in zip(models, facts, strict=True)}
    return mirror_measured("finetune", folder, (_TABLE, _PAGE), metrics, params, uri, experiment)


def _table(file: Path) -> pa.Table:
    return read_parquet(file, "Remove the file: the same command writes it again")[0]


def _params(facts: dict[str, object]) -> dict[str, object]:
    source = facts["finetuned_on"]
    assert isinstance(source, dict)
    kept = {name: source[name] for name in ("spec_hash", "method", "objects")}
    return {"rate": facts["rate"], "steps": facts["steps"], **kept}


def _scores(folder: Path, detector: str, models: Sequence[TunedModel]) -> Iterator[pd.DataFrame]:
    """Yield every model's scores; the objects that vanilla's sweep found also count as adaptive for vanilla."""
    for sweep in HELD_OUT:
        before = attacked_scores(folder / sweep, detector).to_pandas()
        yield _named(before, VANILLA, None, sweep)
        found = before[before["method"] == "adversarial"]
        yield _named(found.assign(method=ADAPTIVE), VANILLA, None, sweep)
        for tuned in models:
            yield _named(_table(tuned.scores_file(sweep)).to_pandas(), tuned.model, tuned.seed, sweep)
            if (tuned.folder / sweep / "final" / "solutions.parquet").is_file():
                own = attacked_scores(tuned.folder / sweep, detector, tuned.weights).to_pandas()
                own = own[own["method"] == "adversarial"]
                yield _named(own.assign(method=ADAPTIVE), tuned.model, tuned.seed, sweep)


def _named(scores: pd.DataFrame, model: str, seed: int | None, sweep: str) -> pd.DataFrame:
    named = scores.rename(columns={"method": "objects"}).drop(columns="task_id")
    return named.assign(model=model, seed=float("nan") if seed is None else float(seed), scene_set=sweep)
