"""Every format once: exports a dataset, prints a table of sizes, times and memory, and calls the judges that are here.

    python tests/judges/formats.py DATASET OUT [JUDGE=PYTHON ...]

OUT must not exist. JUDGE is `lerobot`, `lerobot-v2.1` or `habitat`, PYTHON that of its environment. Run with the own
environment of the project; `make test-formats` does all of it. Ends with exit code 1 when a judge was not content.
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
RUNS: dict[str, tuple[str, ...]] = {
    "paper": ("paper",),
    "lerobot": ("lerobot",),
    "lerobot-all": ("lerobot", *ALL),
    "lerobot-v2.1": ("lerobot-v2.1",),
    "lerobot-v2.1-slow": ("lerobot-v2.1", "--fps", "20"),
    "webdataset": ("webdataset",),
    "mcap": ("mcap",),
    "gnm": ("gnm",),
    "vlnce": ("vlnce",),
}
"""Folder -> format and its options."""
JUDGES: dict[str, tuple[str, ...]] = {
    "lerobot": ("lerobot_judge.py", "paper", "lerobot", "lerobot-all", "lerobot-v2.1"),
    "lerobot-v2.1": ("lerobot_v21_judge.py", "paper", "lerobot-v2.1", "lerobot-v2.1-slow"),
    "habitat": ("habitat_judge.py", "paper", "vlnce"),
}
"""Judge -> its file, and the folders it is shown."""


class Measured(NamedTuple):
    """One export in one process."""

    frames: int
    size_bytes: int
    cpu_s: float
    peak_mib: float
    """Of the largest process."""


def main(dataset: Path, out: Path, pythons: dict[str, str]) -> int:
    out.mkdir(parents=True)
    say("| export | frames | MB | kB a frame | CPU ms a frame | frames/s of one core | largest process, MiB |")
    say("|---|---|---|---|---|---|---|")
    for folder, words in RUNS.items():
        say(row(" ".join(words), export(dataset, out / folder, words)))
    verdicts = [is_content(name, pythons.get(name), out) for name in JUDGES]
    return 0 if all(verdicts) else 1


def is_content(name: str, python: str | None, out: Path) -> bool:
    if python is None:
        say(f"judge {name} was not asked: give {name}=PYTHON, that of its environment")
        return True
    script, *folders = JUDGES[name]
    command = [
        python,
        "-W",
        "ignore",
        str(Path(__file__).with_name(script)),
        *(str(out / folder) for folder in folders),
    ]
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(out / ".huggingface")}
    is_fine = subprocess.run(command, env=environment, check=False).returncode == 0
    say(f"judge {name}: {'content' if is_fine else 'NOT CONTENT'}")
    return is_fine


def export(dataset: Path, out: Path, words: tuple[str, ...]) -> Measured:
    name, *options = words
    command = [sys.executable, "-m", "factory", "export", str(dataset), "--to", name, "-o", str(out), *options]
    with tempfile.TemporaryFile() as told:
        process = subprocess.Popen([*command, "--workers", "1", "--json"], stdout=told, stderr=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        told.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
        report = json.load(told)
    return Measured(report["frames"], report["bytes"], usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def row(what: str, found: Measured) -> str:
    a_frame = found.cpu_s / found.frames
    size = f"{found.size_bytes / 1e6:.1f} | {found.size_bytes / 1e3 / found.frames:.1f}"
    return f"| `{what}` | {found.frames} | {size} | {1e3 * a_frame:.1f} | {1 / a_frame:.0f} | {found.peak_mib:.0f} |"


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), dict(word.split("=", 1) for word in sys.argv[3:])))
