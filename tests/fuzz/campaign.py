"""`make fuzz`: fuzzes each target for a limited time, in a process with limited memory; exits with 1 on findings."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from schemas.support.child import python_module
from tests.fuzz.child import LAST
from tests.fuzz.targets import TARGETS


def fuzz(target: str, folder: Path, seed: int, seconds: float, count: int = sys.maxsize) -> str:
    """Fuzzes one target; returns a description of its findings, or an empty text.

    Args:
        target: name of the target.
        folder: working directory; findings stay there.
        seed: seed of the mutations.
        seconds: time limit.
        count: maximum number of inputs.
    """
    folder.mkdir(parents=True, exist_ok=True)
    words = python_module("tests.fuzz.child", target, str(seed), str(seconds), str(count), str(folder))
    root = Path(__file__).parents[2]
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", timeout=seconds + 120, cwd=root)
    sys.stdout.write(done.stdout)
    if done.returncode == 0:
        return ""
    how = f"{target}: exit status {done.returncode}, seed {seed}, last input {folder / LAST}"
    return "\n".join([how, *done.stderr.splitlines()[-25:]])


def main() -> int:
    """Fuzzes all targets one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--minutes", type=float, default=12.0, help="Time for all targets together, minutes (default 12)."
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--target", choices=tuple(TARGETS), action="append")
    parser.add_argument("--out", type=Path, default=Path("build/fuzz"))
    arguments = parser.parse_args()
    chosen = arguments.target or list(TARGETS)
    seconds = 60 * arguments.minutes / len(chosen)
    found = [fuzz(name, (arguments.out / name).resolve(), arguments.seed, seconds) for name in chosen]
    sys.stderr.writelines(f"{text}\n" for text in found if text)
    return 1 if any(found) else 0


if __name__ == "__main__":
    sys.exit(main())
