"""Launch specs state where a sweep runs and nothing else, in the terms of the tool that reads them."""

from __future__ import annotations

import json
import re
import shlex
import string
import subprocess
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from jobs.kuberay_schema import RAY_JOB

from shift3d.cli.command import key_values
from shift3d.cli.commands.detectors import gate
from shift3d.cli.completion import job_names
from shift3d.cli.job_spec import JobSpec, pop_job, read_job
from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.settings.compose import compose_sweep, validate

JOBS = Path(__file__).resolve().parents[2] / "jobs"
OWN = ("local", "ray_cluster", "ray_job")


def test_every_spec_is_looked_at_here() -> None:
    others = {"Containerfile", "autoscaler.yaml", "gate_ci.yaml", "kuberay.yaml", "slurm.sbatch"}
    assert {path.name for path in JOBS.iterdir()} == {f"{name}.yaml" for name in OWN} | others
    assert tuple(job_names()) == OWN


@pytest.mark.parametrize("name", OWN)
def test_a_spec_of_ours_holds_runner_settings_that_a_sweep_takes(name: str) -> None:
    job, words = pop_job(["smoke", f"job={name}", "mode=shape"])
    assert job and words == ["smoke", "mode=shape"]
    composed = compose_sweep("smoke", [*job.overrides(["mode=shape"]), "mode=shape"])
    plain = compose_sweep("smoke", ["mode=shape"])
    differs = {key for key in plain.base if composed.base[key] != plain.base[key]}
    assert differs <= {"runner"}, "no experiment parameter in a launch spec"
    assert validate(composed.base, name).runner.kind == job.runner["kind"]
    assert (composed.base["runner"]["address"] == "auto") == (name != "local")


def test_what_the_command_says_of_the_runner_wins() -> None:
    job = read_job("ray_cluster")
    given = ["runner.address=10.0.0.1:6379", "runner.workers=3"]
    runner = compose_sweep("smoke", [*job.overrides(given), *given]).base["runner"]
    assert (runner["address"], runner["workers"]) == ("10.0.0.1:6379", 3)
    assert compose_sweep("smoke", [*job.overrides(["runner=local"]), "runner=local"]).base["runner"]["kind"] == "local"


def test_a_job_that_is_none_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=r"job=moon cannot be read.*local, ray_cluster, ray_job"):
        pop_job(["job=moon"])
    with pytest.raises(InputError, match="another tool"):
        pop_job(["job=kuberay"])
    for text in ("kind: local\n", "[]\n", "kind: local\nrunner: {kind: ray}\nattack: {steps: 1}\n", "kind: [\n", ""):
        (tmp_path / "job.yaml").write_text(text)
        with pytest.raises(InputError, match=r"job\.yaml"):
            read_job(str(tmp_path / "job.yaml"))
    with pytest.raises(ValueError, match="address belongs to a ray_job"):
        JobSpec(kind="ray_job", runner={"kind": "ray"})
    assert main(["sweep", "smoke", "job=ray_job", "out=here"]) == 2
    assert "Give out=s3://BUCKET/FOLDER" in capsys.readouterr().err
    assert main(["sweep", "smoke", "job=ray_job", "--dry-run"]) == 0, "a plan needs no cluster"


def test_the_ci_example_gives_the_gate_words_that_it_takes() -> None:
    steps = yaml.safe_load((JOBS / "gate_ci.yaml").read_text())["jobs"]["gate"]["steps"]
    (command,) = [shlex.split(step["run"]) for step in steps if "shift3d gate" in step.get("run", "")]
    values = key_values(command[2:], gate.KEYS, ("suite", "detector", "weights", "accept"), "gate")
    assert values["out"] == "outputs/gate" and steps[-1]["with"]["path"].startswith(values["out"])


def test_the_autoscalers_file_fits_rays_own_schema() -> None:
    import ray.autoscaler

    spec = yaml.safe_load((JOBS / "autoscaler.yaml").read_text())
    schema = json.loads((Path(ray.autoscaler.__file__).parent / "ray-schema.json").read_text())
    jsonschema.validate(spec, schema)
    assert spec["head_node_type"] in spec["available_node_types"]
    starts = " ".join(spec["head_start_ray_commands"] + spec["worker_start_ray_commands"])
    assert starts.count("RAY_AUTH_MODE=token") == 2 and "--dashboard-host=127.0.0.1" in starts
    assert all("ImageId" in node["node_config"] for node in spec["available_node_types"].values())
    assert any("--python 3.11" in command for command in spec["setup_commands"])
    for command in [*spec["setup_commands"], *spec["head_start_ray_commands"], *spec["worker_start_ray_commands"]]:
        subprocess.run(["bash", "-n", "-c", command], check=True)


def kuberay() -> Any:
    text = string.Template((JOBS / "kuberay.yaml").read_text())
    words = {"OUT": "s3://b/f", "TRACKING": "tracking.uri=https://MLFLOW", "ARGS": "runner.workers=64"}
    return yaml.safe_load(text.substitute(IMAGE="shift3d", SWEEP="default", **words))


def test_kuberays_file_fits_its_published_fields_and_asks_for_a_token() -> None:
    spec = kuberay()
    jsonschema.validate(spec, RAY_JOB)
    cluster = spec["spec"]["rayClusterSpec"]
    assert cluster["authOptions"] == {"mode": "token"}
    assert f"ray=={cluster['rayVersion']}\n" in (JOBS.parent / "constraints.txt").read_text()
    assert cluster["headGroupSpec"]["serviceType"] == "ClusterIP", "nothing of it outside its Kubernetes"


def test_the_image_is_of_the_ray_that_the_specs_and_the_constraints_name() -> None:
    text = _uncommented(JOBS / "Containerfile")
    (version,) = re.findall(r"^FROM rayproject/ray:([\d.]+)-py311$", text, flags=re.MULTILINE)
    assert kuberay()["spec"]["rayClusterSpec"]["rayVersion"] == version
    assert "-c /tmp/dist/constraints.txt /tmp/dist/shift3d-*.whl" in text
    makes = subprocess.run(["make", "-n", "wheel"], cwd=JOBS.parent, capture_output=True, text=True, check=True)
    assert "-w dist ." in makes.stdout and "cp constraints.txt dist/" in makes.stdout
    assert yaml.safe_load((JOBS / "autoscaler.yaml").read_text())["file_mounts"]["~/shift3d"] == "dist"


def test_credentials_are_a_secret_of_every_container_that_runs_the_driver_or_tasks() -> None:
    cluster = kuberay()["spec"]["rayClusterSpec"]
    for group in (cluster["headGroupSpec"], *cluster["workerGroupSpecs"]):
        for container in group["template"]["spec"]["containers"]:
            assert [source["secretRef"]["name"] for source in container["envFrom"]] == ["shift3d-bucket"]
    assert not re.search(r"(KEY|SECRET|PASSWORD)\w*, value", (JOBS / "kuberay.yaml").read_text())


def test_the_autoscalers_workers_can_have_a_role_that_reads_scenes() -> None:
    text = re.sub(r"# (IamInstanceProfile: {)", r"\1", (JOBS / "autoscaler.yaml").read_text())
    worker = yaml.safe_load(text)["available_node_types"]["worker"]["node_config"]
    assert worker["IamInstanceProfile"]["Arn"].startswith("arn:aws:iam::")


def test_a_failed_sweep_makes_no_second_cluster() -> None:
    assert kuberay()["spec"]["backoffLimit"] == 0


@pytest.mark.parametrize("name", ["autoscaler.yaml", "kuberay.yaml"])
def test_a_spec_says_how_workers_read_recorded_scenes(name: str) -> None:
    assert "scenes.root=s3://BUCKET/FOLDER" in (JOBS / name).read_text().partition("\n\n")[0]


@pytest.mark.parametrize("name", ["autoscaler.yaml", "kuberay.yaml", "ray_job.yaml", "slurm.sbatch"])
def test_no_command_leaves_mlflow_in_a_file_of_a_machine_that_goes_away(name: str) -> None:
    text = (JOBS / name).read_text()
    assert "tracking.uri=https://MLFLOW" in text and "tracking=none" in text


@pytest.mark.parametrize("path", [("spec", "entryPoint"), ("spec", "rayClusterSpec", "authOption"), ("spec", "sweep")])
def test_a_field_that_kuberay_does_not_know_is_found(path: tuple[str, ...]) -> None:
    spec = kuberay()
    place = spec
    for name in path[:-1]:
        place = place[name]
    place[path[-1]] = "x"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(spec, RAY_JOB)


def test_slurms_script_parses_and_its_directives_are_slurms() -> None:
    path = JOBS / "slurm.sbatch"
    subprocess.run(["bash", "-n", str(path)], check=True)
    directives = dict(re.fullmatch(r"#SBATCH --([a-z-]+)(?:=(.+))?", line).groups() for line in _directives(path))  # type: ignore[union-attr]
    known = {"job-name", "nodes", "ntasks-per-node", "exclusive", "mem", "time", "requeue", "output", "cpus-per-task"}
    assert directives.keys() <= known
    assert directives["ntasks-per-node"] == "1", "one Ray a node"
    assert re.fullmatch(r"\d+:\d\d:\d\d", directives["time"])


def run_slurm(folder: Path, tools: dict[str, str], **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the script with these tools, name to shell lines; those in slurm/ precede the system's."""
    for name, text in {"slurm/scontrol": "echo n", **tools}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"#!/bin/bash\n{text}\n")
        (folder / name).chmod(0o755)
    path = {"PATH": f"{folder / 'slurm'}:/usr/bin:/bin", "SLURM_JOB_NODELIST": "n", "SLURM_JOB_NUM_NODES": "1"}
    command = ["bash", str(JOBS / "slurm.sbatch"), "default"]
    known = path | {"SLURM_CPUS_ON_NODE": "1", **environment}
    return subprocess.run(command, cwd=folder, env=known, capture_output=True, text=True, check=False)


def test_slurms_python_is_that_of_the_folder_or_the_one_given(tmp_path: Path) -> None:
    names = ("repo/.venv/bin/shift3d", "repo/.venv/bin/ray", "mine/bin/shift3d", "mine/bin/ray")
    tools = {"slurm/srun": "command -v shift3d", **dict.fromkeys(names, "true")}
    absent = run_slurm(tmp_path, tools)
    assert absent.returncode == 2 and "make setup" in absent.stderr
    here, mine = str(tmp_path / "repo"), str(tmp_path / "mine")
    assert run_slurm(tmp_path, tools, SLURM_SUBMIT_DIR=here).stdout.strip() == f"{here}/.venv/bin/shift3d"
    assert run_slurm(tmp_path, tools, VENV=mine).stdout.strip() == f"{mine}/bin/shift3d"


@pytest.mark.parametrize(("sweeps_code", "code"), [(0, 0), (3, 3), (None, 1)])
def test_a_slurm_job_ends_with_the_code_of_its_sweep_or_has_failed(
    sweeps_code: int | None, code: int, tmp_path: Path
) -> None:
    """The case None: Ray does not start, and `ray symmetric-run` ends with 0 nevertheless."""
    runs = 'while [ "$1" != -- ]; do shift; done; shift; "$@"'
    sweep = f'echo "$@" > {tmp_path / "words"}; exit {sweeps_code}'
    tools = {"slurm/srun": "true" if sweeps_code is None else runs, "bin/shift3d": sweep, "bin/ray": "true"}
    (tmp_path / "tmp").mkdir()
    done = run_slurm(tmp_path, tools, VENV=str(tmp_path), TMPDIR=str(tmp_path / "tmp"))
    assert done.returncode == code, done
    assert list((tmp_path / "tmp").iterdir()) == []
    if sweeps_code is not None:
        assert (tmp_path / "words").read_text() == "sweep default job=ray_cluster\n"


def test_the_time_that_slurms_nodes_wait_for_each_other_is_a_variable_of_this_ray() -> None:
    import ray.scripts.symmetric_run as module

    (name,) = re.findall(r"export (RAY_\w+)=300", (JOBS / "slurm.sbatch").read_text())
    assert name in Path(module.__file__).read_text()


def _uncommented(path: Path) -> str:
    """Return a file's text with the commands of its comments, as a shell reads them."""
    return path.read_text().replace("\n#", "\n").replace("\\\n", "")


def _directives(path: Path) -> list[str]:
    lines = path.read_text().splitlines()
    assert lines[0] == "#!/bin/bash"
    found = [index for index, line in enumerate(lines) if line.startswith("#SBATCH")]
    first_command = next(index for index, line in enumerate(lines) if line and not line.startswith("#"))
    assert found and max(found) < first_command, "Slurm reads no directive after the first command"
    return [lines[index] for index in found]


def test_a_command_on_a_cluster_is_the_same_whoever_made_the_cluster() -> None:
    (launched,) = re.findall(r"ray exec jobs/autoscaler.yaml '([^']*)'", _uncommented(JOBS / "autoscaler.yaml"))
    submitted = kuberay()["spec"]["entrypoint"].replace("s3://b/f", "s3://BUCKET/FOLDER")
    assert sorted(shlex.split(submitted)) == sorted(shlex.split(launched))
    assert shlex.split(launched)[:4] == ["shift3d", "sweep", "default", "job=ray_cluster"]
