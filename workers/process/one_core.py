"""The surroundings of a process that draws on one core: what Mesa, numpy and glibc read when it starts.

Pure: it names the settings and starts nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["one_core"]

_THREADS = {"LP_NUM_THREADS": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
_TUNABLES = "GLIBC_TUNABLES"
_HUGE_PAGES = "glibc.malloc.hugetlb=1"
"""malloc asks for transparent huge pages. Looking a texture up then misses the address cache less often: 3-8 % of a
rendered frame, for 5 MB. Another libc, and a kernel that gives no huge pages, ignore it."""


def one_core(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns the environment with these settings; what was tuned in glibc otherwise stays."""
    tuned = [each for each in environment.get(_TUNABLES, "").split(":") if each and "malloc.hugetlb=" not in each]
    return {**environment, **_THREADS, _TUNABLES: ":".join([*tuned, _HUGE_PAGES])}
