"""Exports a dataset to every format; prints a table of sizes, times and memory, and one of the results of the readers.

    python tests/readers/formats.py DATASET OUT [ENVIRONMENT=PYTHON ...] [visualnav=CHECKOUT]

OUT must not exist. ENVIRONMENT is `readers`, `lerobot`, `lerobot-v2.1` or `habitat`, PYTHON its interpreter; CHECKOUT
is a checkout of robodhruv/visualnav-transformer, whose loader is tested if given. Run it in the environment of the
project; `make test-formats` does all steps. Exits with code 1 when a reader failed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ALL = ("--fps", "20", "--depth", "--ids")
RIG = ("--rig", "turtlebot4", "--episode", "1")
RUNS: dict[str, tuple[str, ...]] = {
    "paper": ("paper",),
    "lerobot": ("lerobot",),
    "lerobot-all": ("lerobot", *ALL),
    "lerobot-v2.1": ("lerobot-v2.1",),
    "lerobot-v2.1-slow": ("lerobot-v2.1", "--fps", "20"),
    "webdataset": ("webdataset",),
    "mcap": ("mcap",),
    "mcap-ros2": ("mcap", "--ros2"),
    "gnm": ("gnm",),
    "vlnce": ("vlnce",),
    "navdp": ("navdp", "--fps", "20"),
    "internnav": ("internnav",),
    "rlds": ("rlds",),
    "rlds-640": ("rlds", "--fps", "10", "--image-px", "640", "--loader-splits"),
    "robomimic": ("robomimic",),
    "robomimic-640": ("robomimic", "--fps", "10", "--image-px", "640"),
    "paper-rig": ("paper", *RIG),
    "lerobot-rig": ("lerobot", *ALL, *RIG),
}
"""Folder -> format and its options."""


class Reader(NamedTuple):
    """A script in this folder that reads exports with third-party readers of their format."""

    environment: str
    shown: tuple[str, ...]
    """Arguments of the script: `dataset`, or folders of OUT."""


READERS: dict[str, Reader] = {
    "paper": Reader("readers", ("dataset", "paper")),
    "datasets": Reader("readers", ("dataset", "paper", "lerobot", "webdataset")),
    "video": Reader("readers", ("lerobot", "lerobot-all", "lerobot-v2.1", "lerobot-v2.1-slow")),
    "lerobot": Reader("lerobot", ("paper", "lerobot", "lerobot-all", "lerobot-v2.1")),
    "lerobot_rig": Reader("lerobot", ("paper-rig", "lerobot-rig")),
    "lerobot_v21": Reader("lerobot-v2.1", ("paper", "lerobot-v2.1", "lerobot-v2.1-slow")),
    "webdataset": Reader("readers", ("paper", "webdataset")),
    "mcap": Reader("readers", ("paper", "mcap")),
    "ros2": Reader("readers", ("paper", "mcap-ros2")),
    "gnm": Reader("lerobot", ("paper", "gnm")),
    "internnav": Reader("lerobot", ("navdp", "internnav")),
    "habitat": Reader("habitat", ("paper", "vlnce")),
    "rlds": Reader("readers", ("paper", "rlds", "rlds-640")),
    "robomimic": Reader("readers", ("paper", "robomimic", "robomimic-640")),
    "rerun": Reader("readers", ("dataset", "paper", "mcap", "lerobot", "lerobot-v2.1")),
}
"""Name of the script without `_reader.py` -> its environment and the folders that it compares."""


class Measured(NamedTuple):
    """Measurements of one export in one process."""

    frames: int
    size_bytes: int
    cpu_s: float
    peak_mib: float
    """Peak memory of the largest process, MiB."""


def main(dataset: Path, out: Path, places: dict[str, str]) -> int:
    out.mkdir(parents=True)
    print_line(
        "| export | frames | MB | kB per frame | CPU ms per frame | frames/s of one core | largest process, MiB |"
    )
    print_line("|---|---|---|---|---|---|---|")
    for folder, words in RUNS.items():
        print_line(row(" ".join(words), export(dataset, out / folder, words)))
    print_line("\n| export | opened with | read back |\n|---|---|---|")
    failed = [name for name in READERS if not is_read_back(name, dataset, out, places)]
    print_line(f"\nFAILED: {', '.join(failed)}" if failed else f"\n{len(READERS)} readers passed")
    return 1 if failed else 0


def is_read_back(name: str, dataset: Path, out: Path, places: dict[str, str]) -> bool:
    """Runs a reader and prints its rows; other output goes to stderr."""
    reader = READERS[name]
    if reader.environment not in places:
        sys.stderr.write(
            f"reader {name} cannot run: give {reader.environment}=PYTHON with the Python of its environment\n"
        )
        return False
    shown = [str(dataset if folder == "dataset" else out / folder) for folder in reader.shown]
    if name == "gnm" and places.get("visualnav"):
        shown.append(places["visualnav"])
    if name == "internnav":
        if not places.get("internnav"):
            sys.stderr.write("the loaders of InternNav were not tested: give internnav=CHECKOUT\n")
            return True
        shown.append(places["internnav"])
    command = [places[reader.environment], "-W", "ignore", str(Path(__file__).with_name(f"{name}_reader.py")), *shown]
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(out / ".huggingface")}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            (sys.stdout if line.startswith("| ") else sys.stderr).write(line)
            sys.stdout.flush()
    return process.returncode == 0


def export(dataset: Path, out: Path, words: tuple[str, ...]) -> Measured:
    name, *options = words
    command = [sys.executable, "-m", "factory", "export", str(dataset), "--to", name, "-o", str(out), *options]
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen([*command, "--workers", "1", "--json"], stdout=output, stderr=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
        report = json.load(output)
    return Measured(report["frames"], report["bytes"], usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def row(what: str, found: Measured) -> str:
    a_frame = found.cpu_s / found.frames
    size = f"{found.size_bytes / 1e6:.1f} | {found.size_bytes / 1e3 / found.frames:.1f}"
    return f"| `{what}` | {found.frames} | {size} | {1e3 * a_frame:.1f} | {1 / a_frame:.0f} | {found.peak_mib:.0f} |"


def print_line(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), dict(word.split("=", 1) for word in sys.argv[3:])))
