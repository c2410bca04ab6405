"""Checks the deployment files: every command line is valid, every metric exists."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click
import pytest
import yaml

from coordinator.expansion.plan_file import load_plan
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.status.address import HttpAddress
from coordinator.status.server import StatusServer
from factory.cli.main import cli
from factory.submit.slurm import RUN_TASK
from tests.builders.ledger import room_catalog, room_plan
from tests.integration.test_status_pages import ask
from workers.client.supervisor import STOPPED

DEPLOY = Path(__file__).parents[2] / "deploy"
MANIFESTS = sorted((DEPLOY / "kubernetes").rglob("*.yaml"))
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))
BATCH = json.loads((DEPLOY / "cloud" / "aws_batch.json").read_text())
OVERLAYS = ("base", "shards", "with-gateway")
KUBERNETES = "1.33"
"""Version of Kubernetes whose schemas are compared with the manifests."""
SCRIPTS = sorted(DEPLOY.rglob("*.sh"))


def documents(path: Path) -> list[dict[str, Any]]:
    return [document for document in yaml.safe_load_all(path.read_text()) if document]


def containers() -> Iterator[dict[str, Any]]:
    for path in MANIFESTS:
        for document in documents(path):
            template = document.get("spec", {}).get("template") if isinstance(document.get("spec"), dict) else None
            yield from template["spec"]["containers"] if template else ()


def command_lines() -> list[tuple[str, list[str]]]:
    found = [
        ("kubernetes", _of_shell(container["args"][0]) if "command" in container else container["args"])
        for container in containers()
    ]
    found.append(("AWS Batch", _of_shell(BATCH["containerOverrides"]["command"][2])))
    found.append(("SkyPilot", _of_shell(documents(DEPLOY / "cloud" / "skypilot.yaml")[0]["run"])))
    found.append(("HF Jobs", _of_shell((DEPLOY / "cloud" / "hf_jobs.sh").read_text())))
    compose = documents(DEPLOY / "compose.yaml")[0]
    found += [(f"compose {name}", _filled(service["command"])) for name, service in compose["services"].items()]
    for unit in UNITS:
        (line,) = re.findall(r"^ExecStart=\S*/factory (.*)$", unit.read_text(), re.MULTILINE)
        found.append((unit.name, shlex.split(line.replace("${CORES}", "8").replace("${HUB}", "hub:7447"))))
    (line,) = re.findall(r"^run_task 130 factory (.*)$", (DEPLOY / "slurm" / "workers.sh").read_text(), re.MULTILINE)
    found.append(("slurm", shlex.split(line.replace("${cores}", "8"))))
    readme = (DEPLOY / "README.md").read_text()
    for line in re.findall(r"^(?:\w+:\s+)?factory (.*?)\s*(?:#.*)?$", readme, re.MULTILINE):
        found.append((f"README: {line}", shlex.split(line)))
    return found


def _of_shell(text: str) -> list[str]:
    """Returns the words after the last `factory` of a command; plan variables become `demo`, all others 8."""
    command = re.split(r"\bfactory\s", text)[-1].partition("\n")[0]
    return shlex.split(
        re.sub(r"\$\{(\w+)\}", lambda found: {"plan": "demo", "PLAN": "demo"}.get(found[1], "8"), command)
    )


def _filled(words: Sequence[str]) -> list[str]:
    """Replaces each `${NAME:-default}` by the default."""
    return [re.sub(r"\$\{\w+:-(\w+)\}", r"\1", str(word)) for word in words]


@pytest.mark.parametrize(("where", "words"), [pytest.param(*line, id=line[0][:60]) for line in command_lines()])
def test_every_command_line_is_valid(where, words):
    command: click.Command = cli
    context = click.Context(cli)
    rest = list(words)
    while isinstance(command, click.Group):
        name = rest.pop(0)
        found = command.get_command(context, name)
        assert found is not None, f"{where}: unknown verb {name}"
        command = found
    command.make_context(command.name, rest)  # parses every option and argument, runs nothing


def test_kustomize_accepts_every_manifest():
    named = {
        resource
        for path in MANIFESTS
        if path.name == "kustomization.yaml"
        for resource in documents(path)[0].get("resources", ())
    }
    assert named - {"../base"} == {path.name for path in MANIFESTS if path.name != "kustomization.yaml"}
    assert load_plan(str(DEPLOY / "kubernetes" / "base" / "plan.toml")).episodes == 700


@pytest.mark.parametrize(
    "path", [path for path in MANIFESTS if path.name != "kustomization.yaml"], ids=lambda p: p.stem
)
def test_manifests_fulfil_the_strict_schemas_of_kubernetes(path):
    for document in documents(path):
        require_valid(document)


def require_valid(document: dict[str, Any]) -> None:
    pytest.importorskip("kubernetes_validate").validate(document, KUBERNETES, strict=True)


def rendered(folder: Path) -> list[dict[str, Any]]:
    if shutil.which("kubectl") is None:
        pytest.skip("needs kubectl")
    done = subprocess.run(["kubectl", "kustomize", str(folder)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return list(yaml.safe_load_all(done.stdout))


@pytest.mark.parametrize("place", OVERLAYS)
def test_kustomize_renders_the_manifests_with_one_image(place, tmp_path):
    copy = tmp_path / "kubernetes"
    shutil.copytree(DEPLOY / "kubernetes", copy)
    image = copy / "image" / "kustomization.yaml"
    image.write_text(re.sub("newName: .*", "newName: registry.example.org/mine", image.read_text()))
    found = rendered(copy / place)
    kinds = sorted(document["kind"] for document in found)
    base = ["ConfigMap", "Job", "Namespace", *["NetworkPolicy"] * 2, "PodDisruptionBudget", "Service", "StatefulSet"]
    more = {"with-gateway": ["NetworkPolicy", "PodDisruptionBudget", "Service", "StatefulSet"]}.get(place, [])
    assert kinds == (["ConfigMap", "Job"] if place == "shards" else sorted([*base, *more]))
    assert {document["metadata"].get("namespace", "minivla") for document in found} == {"minivla"}
    pods = [one["spec"]["template"]["spec"] for one in found if one["kind"] in {"Job", "StatefulSet"}]
    images = {container["image"] for pod in pods for container in pod["containers"]}
    project = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())
    assert images == {f"registry.example.org/mine:{project['project']['version']}"}
    for document in found:
        require_valid(document)


def test_components_add_an_external_address_and_a_queue(tmp_path):
    copy = tmp_path / "kubernetes"
    shutil.copytree(DEPLOY / "kubernetes", copy)
    for overlay, component in (("base", "external"), ("shards", "kueue")):
        file = copy / overlay / "kustomization.yaml"
        file.write_text(file.read_text().replace("components:\n", f"components:\n  - ../{component}\n"))
    base, shards = rendered(copy / "base"), rendered(copy / "shards")
    assert [one["spec"].get("type") for one in base if one["kind"] == "Service"].count("LoadBalancer") == 1
    (policy,) = [one for one in base if one["kind"] == "NetworkPolicy" and one["metadata"]["name"] == "coordinator"]
    assert {"ports": [{"port": 7447}]} in policy["spec"]["ingress"]
    (job,) = [one for one in shards if one["kind"] == "Job"]
    assert job["metadata"]["labels"]["kueue.x-k8s.io/queue-name"] == "minivla"
    assert job["spec"]["suspend"]
    assert all(one["spec"]["ttlSecondsAfterFinished"] > 0 for one in (*base, *shards) if one["kind"] == "Job")
    for document in (*base, *shards):
        require_valid(document)


def outcome_of(job: dict[str, Any], status: int, *, is_disrupted: bool = False) -> str:
    """Returns the action of the podFailurePolicy of a job for a failed pod, by the rules of Kubernetes."""
    for rule in job["spec"]["podFailurePolicy"]["rules"]:
        codes, conditions = rule.get("onExitCodes"), rule.get("onPodConditions", ())
        if codes is not None and codes["operator"] == "In" and status in codes["values"]:
            return str(rule["action"])
        if is_disrupted and any(one == {"type": "DisruptionTarget", "status": "True"} for one in conditions):
            return str(rule["action"])
    return "Count"


@pytest.mark.parametrize(("name", "wrong_usage"), [("base/workers", "FailJob"), ("shards/job", "FailIndex")])
def test_stopped_and_evicted_pods_of_a_job_are_replaced_without_limit(name, wrong_usage):
    (job,) = documents(DEPLOY / "kubernetes" / f"{name}.yaml")
    pod = job["spec"]["template"]["spec"]
    assert pod["restartPolicy"] == "Never"  # a podFailurePolicy requires it
    assert job["spec"].get("podReplacementPolicy", "Failed") == "Failed"  # with such a policy, the only valid value
    containers = {container["name"] for container in pod["containers"]}
    rules = job["spec"]["podFailurePolicy"]["rules"]
    assert {rule["onExitCodes"]["containerName"] for rule in rules if "onExitCodes" in rule} == containers
    assert outcome_of(job, STOPPED) == "Ignore"
    assert outcome_of(job, 137, is_disrupted=True) == "Ignore"
    assert outcome_of(job, 2) == wrong_usage
    assert outcome_of(job, 3) == "Count"


def test_disruption_budgets_select_the_pods_with_a_volume(tmp_path):
    found = rendered(DEPLOY / "kubernetes" / "with-gateway")
    pods = {one["metadata"]["name"]: one["spec"]["template"] for one in found if one["kind"] == "StatefulSet"}
    budgets = {one["metadata"]["name"]: one["spec"] for one in found if one["kind"] == "PodDisruptionBudget"}
    assert budgets.keys() == pods.keys()
    for name, budget in budgets.items():
        matching = [
            each
            for each, pod in pods.items()
            if budget["selector"]["matchLabels"].items() <= pod["metadata"]["labels"].items()
        ]
        assert matching == [name]


def test_batch_systems_start_every_shard_of_a_run():
    (job,) = documents(DEPLOY / "kubernetes" / "shards" / "job.yaml")
    (container,) = job["spec"]["template"]["spec"]["containers"]
    assert f'/{job["spec"]["completions"]}"' in container["args"][0]
    assert f'/{BATCH["arrayProperties"]["size"]}"' in BATCH["containerOverrides"]["command"][2]
    script = container["args"][0].replace("exec factory", "echo")
    for index in (0, 7):
        env = {"JOB_COMPLETION_INDEX": str(index), "MINIVLA_OUT": "s3://b/r", "PATH": os.environ["PATH"]}
        done = subprocess.run([*container["command"], script], env=env, capture_output=True, text=True, check=True)
        assert f"--shard {index + 1}/8 --out s3://b/r/{index + 1} " in done.stdout


def test_the_image_installs_the_runtime_packages_only() -> None:
    text = (DEPLOY / "Dockerfile").read_text()
    (extras,) = re.findall(r'^ARG EXTRAS="(.*)"$', text, re.MULTILINE)
    command = [sys.executable, "deploy/runtime_requirements.py", "requirements.txt", "pyproject.toml", *extras.split()]
    lines = subprocess.run(command, cwd=DEPLOY.parent, capture_output=True, text=True, check=True).stdout
    names = set(re.findall(r"^([\w.-]+)==", lines, re.MULTILINE))
    assert {"numpy", "pybullet", "eclipse-zenoh", "obstore", "cryptography", "uvicorn"} <= names
    assert names.isdisjoint({"mypy", "ruff", "pytest", "moto", "playwright", "opencv-python-headless", "pandas"})
    assert lines.count("--hash=sha256:") >= len(names)
    locked = (DEPLOY.parent / "requirements.txt").read_text()
    assert all(entry in locked for entry in re.split(r"(?m)^(?=\w)", lines))


def test_the_build_context_contains_what_the_image_copies() -> None:
    kept = set(re.findall(r"^!(.*)$", (DEPLOY.parent / ".dockerignore").read_text(), re.MULTILINE))
    copies = re.findall(r"^COPY (?!--from)(.*) \S+$", (DEPLOY / "Dockerfile").read_text(), re.MULTILINE)
    assert {name for line in copies for name in line.split()} == kept


def test_the_image_contains_each_package_of_the_wheel() -> None:
    project = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())
    packages = project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    copied = re.findall(r"^COPY (\w+) \w+$", (DEPLOY / "Dockerfile").read_text(), re.MULTILINE)
    assert sorted(copied) == sorted(packages)


def test_containers_run_without_privileges():
    compose = documents(DEPLOY / "compose.yaml")[0]
    for container in containers():
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
    for service in compose["services"].values():
        assert (service["read_only"], service["cap_drop"]) == (True, ["ALL"])
    assert re.search(r"^USER (\d+)", (DEPLOY / "Dockerfile").read_text(), re.MULTILINE)


def test_every_mount_has_its_volume():
    for path in MANIFESTS:
        for document in documents(path):
            template = (
                document.get("spec", {}).get("template")
                if document["kind"] not in {"Component", "Kustomization"}
                else None
            )
            if template:
                claims = {claim["metadata"]["name"] for claim in document["spec"].get("volumeClaimTemplates", ())}
                volumes = {volume["name"] for volume in template["spec"]["volumes"]} | claims
                mounts = {mount["name"] for c in template["spec"]["containers"] for mount in c["volumeMounts"]}
                assert mounts == volumes


def test_the_ledger_of_a_dataset_in_object_storage_is_on_a_persistent_volume():
    (image,) = re.findall(r"\bMINIVLA_STATE=(\S+)", (DEPLOY / "Dockerfile").read_text())
    (volumes,) = re.findall(r"^VOLUME (.*)$", (DEPLOY / "Dockerfile").read_text(), re.MULTILINE)
    assert any(image.startswith(f"{volume}/") for volume in json.loads(volumes))
    compose = documents(DEPLOY / "compose.yaml")[0]
    coordinator = compose["services"]["coordinator"]
    kept = {mount.split(":")[1] for mount in coordinator["volumes"] if mount.split(":")[0] in compose["volumes"]}
    assert str(Path(coordinator["environment"]["MINIVLA_STATE"]).parent) in kept
    (pod,) = [
        document
        for document in documents(DEPLOY / "kubernetes/base/coordinator.yaml")
        if "replicas" in document["spec"]
    ]
    claims = {claim["metadata"]["name"] for claim in pod["spec"]["volumeClaimTemplates"]}
    (container,) = pod["spec"]["template"]["spec"]["containers"]
    claimed = {mount["mountPath"] for mount in container["volumeMounts"] if mount["name"] in claims}
    state = {variable["name"]: variable["value"] for variable in container["env"]}["MINIVLA_STATE"]
    assert str(Path(state).parent) in claimed
    for unit in ("minivla-coordinator@", "minivla-gateway"):
        text = (DEPLOY / "systemd" / f"{unit}.service").read_text()
        assert "StateDirectory=minivla\n" in text
        assert re.search(r"^Environment=.*\bMINIVLA_STATE=/var/lib/minivla/", text, re.MULTILINE)


def test_every_metric_in_dashboards_and_alerts_is_served(tmp_path):
    settings = CoordinatorSettings(reserve_bytes=0)
    endpoint = ("tcp/127.0.0.1:0",)
    with (
        Coordinator(
            tmp_path / "out",
            room_plan(1),
            room_catalog(tmp_path),
            CoordinatorOptions(listen=endpoint, settings=settings),
        ) as running,
        StatusServer(HttpAddress("127.0.0.1", 0), running.health) as server,
    ):
        page = ask(server, "/metrics")[1]
    served = set(re.findall(r"^# TYPE (\w+) ", page, re.MULTILINE))
    served |= {f"{name}{end}" for name in served for end in ("_sum", "_count")}
    board = json.loads((DEPLOY / "observe" / "grafana.json").read_text())
    expressions = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
    alerts = documents(DEPLOY / "observe" / "alerts.yml")[0]
    expressions += [rule["expr"] for group in alerts["groups"] for rule in group["rules"]]
    watched = {name for text in expressions for name in re.findall(r"\b(?:minivla|process)_\w+", text)}
    missing = {name for name in watched if name not in served and not name.endswith(("_per_hour", "eta_seconds"))}
    assert not missing
    panels = board["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)


@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.name)
def test_systemd_accepts_the_units(unit, tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    text = unit.read_text().replace("/opt/minivla/bin/factory", shutil.which("true") or "/bin/true")
    place = tmp_path / unit.name.replace("@", "@paper")
    place.write_text(re.sub(r"^(User|Group|EnvironmentFile)=.*$", "", text, flags=re.MULTILINE))
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", str(place)], capture_output=True, text=True)
    complaints = [line for line in done.stderr.splitlines() if unit.stem.split("@")[0] in line]
    assert complaints == []
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shell_scripts_are_valid(script):
    shell = "bash" if "bash" in script.read_text().splitlines()[0] else "sh"
    assert subprocess.run([shell, "-n", str(script)]).returncode == 0
    if shutil.which("shellcheck") is None:
        pytest.skip("needs shellcheck; only the syntax was checked")
    done = subprocess.run(["shellcheck", str(script)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


class Cluster:
    """Stubs of the programs in a Slurm task: `scontrol` records its arguments, `factory` is the script `worker`."""

    def __init__(self, folder: Path, worker: str) -> None:
        self.told = folder / "told"
        self.bin = folder / "bin"
        self.bin.mkdir()
        self._tool("scontrol", f'echo "$@" >> {self.told}')
        self._tool("factory", worker)
        self.environment = {
            "PATH": f"{self.bin}:{os.environ['PATH']}",
            "SLURM_JOB_ID": "17",
            "SLURM_ARRAY_JOB_ID": "15",
            "SLURM_ARRAY_TASK_ID": "2",
            "SLURM_CPUS_PER_TASK": "4",
            "USER": "me",
            "TMPDIR": str(folder),
        }

    @contextmanager
    def task(self) -> Iterator[subprocess.Popen[str]]:
        command = ["bash", str(DEPLOY / "slurm" / "workers.sh"), "tls/hub:7447", "/pki"]
        with subprocess.Popen(
            command, env=self.environment, stdout=subprocess.PIPE, text=True, start_new_session=True
        ) as task:
            try:
                yield task
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(task.pid, signal.SIGKILL)

    def before(self, command: str, deed: str) -> None:
        """Runs the script `deed` directly before a command of the task, so the order of events is fixed."""
        trap = self.bin / "trap.sh"
        trap.write_text(f"""set -T\ntrap 'case "$BASH_COMMAND" in {command}) {deed};; esac' DEBUG\n""")
        self.environment["BASH_ENV"] = str(trap)

    def _tool(self, name: str, body: str) -> None:
        path = self.bin / name
        path.write_text(f"#!/bin/bash\n{body}\n")
        path.chmod(0o755)


def test_the_shipped_slurm_script_has_the_shell_functions_of_factory_submit() -> None:
    assert RUN_TASK in (DEPLOY / "slurm" / "workers.sh").read_text()


@pytest.mark.parametrize(("number", "told"), [(signal.SIGUSR1, "requeue 15_2\n"), (signal.SIGTERM, None)])
def test_a_stopped_slurm_task_lets_its_worker_exit_and_requeues_itself_only_before_its_time_limit(
    tmp_path, number, told
):
    left = tmp_path / "left"
    body = f"trap 'sleep 0.5; touch {left}; exit 130' TERM; echo up; while :; do sleep 0.05; done"
    cluster = Cluster(tmp_path, body)
    with cluster.task() as task:
        assert task.stdout is not None
        assert task.stdout.readline() == "up\n"
        task.send_signal(number)
        assert task.wait(60) == (0 if told else 130)
    assert left.exists(), "the task did not wait for its worker"
    assert (cluster.told.read_text() if cluster.told.exists() else None) == told


def test_a_slurm_task_stopped_before_its_worker_starts_stops_the_worker(tmp_path):
    cluster = Cluster(tmp_path, "while :; do sleep 0.05; done")
    cluster.before(r"child=\$!", "kill -USR1 $$")
    with cluster.task() as task:
        assert task.wait(60) == 0
    assert cluster.told.read_text() == "requeue 15_2\n"


@pytest.mark.parametrize("looks", ["early", "late"])
@pytest.mark.parametrize("status", [0, 1])
def test_a_slurm_task_returns_the_exit_status_of_its_worker(tmp_path, status, looks):
    cluster = Cluster(tmp_path, f'echo "$MINIVLA_CACHE $@"; exit {status}')
    if looks == "late":
        cluster.before(r'wait*|"kill -0"*', "sleep 1")
    with cluster.task() as task:
        out, _ = task.communicate(timeout=60)
    assert task.returncode == status
    assert out == f"{tmp_path}/minivla-me worker --connect tls/hub:7447 --tls /pki --cores 4 --connect-timeout 600\n"
    assert not cluster.told.exists()


def test_the_image_pins_every_package_that_determines_pixels() -> None:
    text = (DEPLOY / "Dockerfile").read_text()
    (arguments,) = re.findall(r"^ARG (MESA.*)$", text, re.MULTILINE)
    versions = dict(word.split("=", 1) for word in shlex.split(arguments))
    (installed,) = re.findall(r"apt-get install -y --no-install-recommends(.*?)&&", text, re.DOTALL)
    packages = dict(word.split("=$", 1) for word in re.findall(r'"([^"]+)"', installed))
    assert packages.keys() == {"libegl1", "libegl-mesa0", "libgl1-mesa-dri", "libglapi-mesa", "libllvm15"}
    assert all(re.match(r"(\d+:)?\d+\.\d", versions[name]) for name in packages.values())
    assert [word for word in installed.split() if word != "\\" and not word.startswith('"')] == []
