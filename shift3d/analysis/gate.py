"""Gate: new weights score the objects of a suite and are compared with the last release; results go to a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from shift3d.analysis.cases.suite_views import view_of
from shift3d.analysis.html.gate import gate_html
from shift3d.analysis.results import places_of
from shift3d.analysis.statistics.loss import least_p_value
from shift3d.analysis.statistics.releases import ReleaseRule
from shift3d.analysis.tables.gate import Comparison, compare, measures_table, simulated_rates, worst_table
from shift3d.detectors.loading import runtime_of
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.progress_bar import progress_bar
from shift3d.store.location import Location
from shift3d.store.user_cache import program_digest
from shift3d.suite.frozen import FrozenSuite
from shift3d.suite.releases import Release, accept_release, last_release
from shift3d.suite.scoring import Scorer, score_suite
from shift3d.suite.tables import suite_table, suite_table_bytes
from shift3d.wording import counted

Acceptance = Literal["false", "true", "anyway"]
_SHOWN = 8
_SCORING = ("detectors", "geometry", "processor.py", "attack/objective.py", "task/scoring.py", "suite")


@dataclass(frozen=True)
class GateSettings:
    """Settings of a gate. rule: decides whether weights are worse. workers: number of processes. against: number of the
    release to compare with; None: the last release of other weights. accept: "true" makes the scores the next release
    if nothing got worse, "anyway" in any case. name: tells the detector from others of its kind, see
    `suite.releases.last_release`."""

    rule: ReleaseRule = field(default_factory=ReleaseRule)
    workers: int = 1
    against: int | None = None
    accept: Acceptance = "false"
    name: str = ""


@dataclass(frozen=True)
class GateOutcome:
    """Result of a gate. exit_code: of the command. text: to print. compared: a comparison was made and written."""

    exit_code: ExitCode
    text: str
    compared: bool = True


def run_gate(
    suite: FrozenSuite, scorer: Scorer, releases: Location, out: Location, settings: GateSettings
) -> GateOutcome:
    """Score the suite, compare with a release, and write the results to ``out``.

    ``out`` gets gate.parquet (one row per object, worst first), verdict.json, gate.html and the answers, so that a
    killed gate resumes. Answers of another version of the program or its libraries are computed again. The same call
    writes the same bytes, whatever the number of workers.

    Raises: InputError: objects of too few scenes, weights that do not fit, no release to compare with, another gate's
    folder, a damaged suite.
    Source: our choice: the paper has no gate.
    """
    _check(suite, scorer, settings.rule)
    detector = _detector(scorer, settings)
    newest = last_release(suite, releases, detector)
    again = newest if newest and newest.number and newest.weights == scorer.digest else None
    last = last_release(suite, releases, detector, settings.against, but=scorer.digest)
    if last is None and again:
        text = f"these weights are already {again.name}, and no release of other weights exists to compare them with"
        return GateOutcome(ExitCode.DONE, text, compared=False)
    if last is None and settings.accept == "false":
        what = f"{detector} has no release to compare with, and the suite does not hold its scores of all objects"
        raise InputError(what, str(releases), "Give accept=true to make these weights the first release")
    _claim(out, suite, scorer)
    program, scores = program_digest(*_SCORING, runtime=runtime_of(scorer.name)), dict[str, float]()
    with progress_bar(total=len(suite.objects), desc="scoring", unit="object") as bar:
        for table in score_suite(suite, scorer, out / f"answers-{program[:16]}", settings.workers):
            scores |= zip(table["object_id"], table["score"], strict=True)
            bar.update(len(table))
    after = {key: scores[key] for key in suite.objects["object_id"]}
    if last is None:
        number = accept_release(suite, releases, detector, scorer.digest, after)
        text = f"{counted(len(after), 'object')} scored; accepted as release {number}, the first of {detector}"
        return GateOutcome(ExitCode.DONE, text, compared=False)
    found = compare(suite.objects, last.scores, after, settings.rule)
    texts = _write(out, suite, scorer, found, last, settings)
    # The newest accepted release passes: a pipeline may run again without new weights.
    passes = not found.worse or (again is not None and settings.against is None)
    if settings.accept == "anyway" or (settings.accept == "true" and not found.worse):
        texts.append(f"accepted as release {accept_release(suite, releases, detector, scorer.digest, after)}")
    elif again:
        texts.append(f"these weights are already {again.name}")
    elif settings.accept == "true":
        texts.append("not accepted: accept=anyway accepts a release that is worse")
    return GateOutcome(ExitCode.DONE if passes else ExitCode.WORSE, "\n\n".join(filter(None, texts)))


def _write(
    out: Location, suite: FrozenSuite, scorer: Scorer, found: Comparison, last: Release, settings: GateSettings
) -> list[str]:
    """Write table, verdict and page. Return the texts to print."""
    sentence, caution = found.sentence(last.name), _caution(suite, last, scorer)
    (out / "gate.parquet").write_atomic(suite_table_bytes(suite_table("gate", found.rows.to_dict("records"))))
    facts = _facts(suite, scorer, last, settings)
    (out / "verdict.json").write_atomic(_verdict(found, sentence, facts))
    worst = found.rows[found.rows["change"] < 0].head(_SHOWN)["object_id"]
    by_id = suite.objects.set_index("object_id", drop=False)
    views = {key: view_of(suite, by_id.loc[key].to_dict(), scorer) for key in worst}
    page = gate_html(found, sentence, caution, views, simulated_rates(found), facts)
    (out / "gate.html").write_atomic(page.encode())
    worse = worst_table(found, 10)
    below = str(worse) if worse else "No score fell."
    return [str(measures_table(found)), below, sentence, caution, f"{out / 'gate.html'} written"]


def _check(suite: FrozenSuite, scorer: Scorer, rule: ReleaseRule) -> None:
    """Refuse a suite or detector that cannot give a verdict, before anything is scored."""
    scenes = places_of(suite.objects).nunique()
    if least_p_value(scenes) > rule.level:
        what = f"has objects of {counted(scenes, 'scene')}: no loss can be significant at level={rule.level:g}"
        remedy = (
            "Freeze a suite of a sweep over more scenes (scenes.count=); frames of one segment or log count once. The "
            f"least level for these scenes is {least_p_value(scenes):g}"
        )
        raise InputError(what, str(suite.folder), remedy)
    for precision in suite.objects["precision"].unique():
        scorer.at(precision)


def _detector(scorer: Scorer, settings: GateSettings) -> str:
    """Return the detector's name in the list of releases, see `suite.releases.last_release`."""
    return f"{scorer.name}:{settings.name}" if settings.name else scorer.name


def _claim(out: Location, suite: FrozenSuite, scorer: Scorer) -> None:
    """Write the owner of the answers to the folder, or refuse a folder with other answers."""
    held = {"suite": suite.digest, "detector": scorer.name, "weights": scorer.digest}
    content = (json.dumps(held, indent=1, sort_keys=True) + "\n").encode()
    if (out / "spec.json").is_file() and (out / "spec.json").read_bytes() != content:
        raise InputError("holds the gate of another suite or other weights", str(out), "Give another out=DIR")
    (out / "spec.json").write_atomic(content)


def _caution(suite: FrozenSuite, last: Release, scorer: Scorer) -> str:
    if last.weights == scorer.digest:
        return "The gate compares these weights with themselves."
    if last.number or scorer.name not in suite.manifest["attacked"]:
        return ""
    return (
        "The hard objects were searched against the weights before, so other weights tend to score them higher "
        "without being better. Look at the controls. The comparison is fair from the first accepted release on."
    )


def _facts(suite: FrozenSuite, scorer: Scorer, last: Release, settings: GateSettings) -> dict[str, str]:
    manifest = suite.manifest
    return {
        "suite": suite.digest,
        "sweep": f"{manifest['made']['sweep']}-{manifest['made']['spec_hash']}",
        "objects": f"{manifest['hard_objects']} hard, {manifest['control_objects']} controls, "
        f"{manifest['scenes']} scenes of {', '.join(manifest['datasets'])}",
        "detector": _detector(scorer, settings),
        "weights": scorer.digest,
        "against": last.name,
        "weights before": last.weights,
        "rule": f"a score above {settings.rule.score_threshold:g} is a detection; weights are worse if any measure "
        f"falls by at least {settings.rule.tolerance:g} with p of at most {settings.rule.level:g}",
    }


def _verdict(found: Comparison, sentence: str, facts: Mapping[str, str]) -> bytes:
    measures = [
        {
            **{name: getattr(measure, name) for name in ("role", "name", "before", "after", "p_value")},
            "change": measure.change.mean,
            # None: a single scene has no finite interval.
            "interval": [v if abs(v) < float("inf") else None for v in (measure.change.low, measure.change.high)],
        }
        for measure in found.measures
    ]
    counts = {
        role: {name: found.counts(role)[name] for name in ("number", "lost", "gained")} for role in ("hard", "control")
    }
    values = {"worse": found.worse, "sentence": sentence, "measures": measures, "objects": counts}
    values |= {"detectable_loss": found.detectable, "facts": dict(facts)}
    return (json.dumps(values, indent=1, sort_keys=True, allow_nan=False) + "\n").encode()
