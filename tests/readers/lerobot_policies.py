"""Trains and serves policies of LeRobot as docs/recipes tells: ACT by `lerobot-train`, SmolVLA with random weights.

Runs in this project's environment with the path of LeRobot's Python (`lerobot[dataset,smolvla,training]`, msgpack and
websockets, see `make test-lerobot`), and exits with code 1 at the first failed check.

    python tests/readers/lerobot_policies.py LEROBOT_PYTHON DATASET WORK
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).parent
SERVER = HERE.parents[1] / "docs" / "recipes" / "lerobot_server.py"
STEPS = 60
SMALL_ACT = (
    *("--policy.type=act", "--policy.pretrained_backbone_weights=null", "--policy.dim_model=64", "--policy.n_heads=4"),
    *("--policy.dim_feedforward=128", "--policy.chunk_size=10", "--policy.n_action_steps=10"),
)


def run(*command: object) -> str:
    """Runs a command without network to the Hub; returns its output."""
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        sys.exit(
            f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    return done.stdout + done.stderr


@contextmanager
def served(python: Path, checkpoint: Path) -> Iterator[str]:
    """Serves a checkpoint; yields the address."""
    command = [python, "-W", "ignore", SERVER, checkpoint, "--fps", "10", "--port", "0", "--device", "cpu"]
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "2"}
    with subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            line = next((line for line in process.stdout if line.startswith("serving ")), "")
            yield line.split()[-1]
        finally:
            process.terminate()


def evaluate(data: Path, specs: Path, name: str, address: str, out: Path) -> None:
    """Evaluates a served policy in short episodes and checks that it drove."""
    factory = Path(sys.executable).with_name("factory")
    options: Sequence[object] = ("--specs", specs, "--workers", 2, "--act-timeout", 300, "--videos", 0)
    run(factory, "eval", data, "--policy", f"{name}={address}", *options, "-o", out)
    (policy,) = json.loads((out / "results.json").read_text())["policies"]
    if set(policy["ends"]) - {"timeout", "collision", "success"}:
        sys.exit(f"{name}: {policy['ends']}, {policy['faults']}")
    if policy["policy"] != name or not policy["made_from"]:
        sys.exit(f"{name}: the results name {policy['policy']}, made from {policy['made_from']}")
    if not policy["overall"]["trajectory_length_m"]["mean"] > 0:
        sys.exit(f"{name}: the robot did not move")
    sys.stdout.write(f"{name}: {policy['ends']}, {policy['act_ms']:.0f} ms per action\n")


def main() -> None:
    python, data, work = (Path(argument).absolute() for argument in sys.argv[1:])
    factory = Path(sys.executable).with_name("factory")
    work.mkdir(parents=True)
    run(factory, "export", data, "--to", "lerobot", "--fps", 10, "--depth", "--ids", "-o", work / "nav")
    run(factory, "eval", "specs", data, "--split", "all", "--episodes", 2, "-o", work / "specs.json")
    specs = json.loads((work / "specs.json").read_text())
    specs["settings"]["task"]["max_steps"] = STEPS
    (work / "specs.json").write_text(json.dumps(specs))
    train = (python, "-W", "ignore", "-m", "lerobot.scripts.lerobot_train", "--batch_size=2", "--steps=2")
    places = ("--dataset.repo_id=local/nav", f"--dataset.root={work / 'nav'}", f"--output_dir={work / 'act'}")
    run(*train, *SMALL_ACT, *places, "--policy.device=cpu", "--policy.push_to_hub=false", "--num_workers=0")
    with served(python, work / "act" / "checkpoints" / "last" / "pretrained_model") as address:
        evaluate(data, work / "specs.json", "act", address, work / "act_results")
    sys.stdout.write(run(python, "-W", "ignore", HERE / "smolvla_checkpoint.py", work / "nav", work / "smolvla"))
    with served(python, work / "smolvla") as address:
        evaluate(data, work / "specs.json", "smolvla", address, work / "smolvla_results")


if __name__ == "__main__":
    main()
