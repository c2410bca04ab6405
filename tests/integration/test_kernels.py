"""A job gives the same bytes with every choice of BLAS and numpy kernels."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

OLDER = "AVX512_ICL X86_V4 X86_V3"
"""Optional kernels of numpy 2.4 on x86; other versions ignore these names."""
CHOICES = {
    "BLAS of 2008": {"OPENBLAS_CORETYPE": "Nehalem"},
    "BLAS of 2013": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS of 2017": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "numpy without AVX-512": {"NPY_DISABLE_CPU_FEATURES": "AVX512_ICL X86_V4"},
    "numpy of 2009": {"NPY_DISABLE_CPU_FEATURES": OLDER},
}
NEEDS = {"SkylakeX": "avx512bw", "Haswell": "avx2"}


def processor_has(feature: str) -> bool:
    return f" {feature} " in Path("/proc/cpuinfo").read_text()


@functools.cache
def computed(choice: str) -> dict[str, str]:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
    words = [sys.executable, "-W", "ignore", "-m", "tests.builders.kernels"]
    done = subprocess.run(words, env=environment | CHOICES.get(choice, {}), capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("choice", CHOICES)
def test_the_kernels_of_other_processors_give_the_same_bytes(choice: str) -> None:
    needed = NEEDS.get(CHOICES[choice].get("OPENBLAS_CORETYPE", ""))
    if needed and not processor_has(needed):
        pytest.skip(f"this processor has no {needed}")
    assert computed(choice) == computed("its own")
