"""Environment variables of a process that renders on one core, read by Mesa, numpy and glibc at its start.

Starts no process and does not change the environment of this one.
"""

from __future__ import annotations

from collections.abc import Mapping

_THREADS = {"LP_NUM_THREADS": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
_TUNABLES = "GLIBC_TUNABLES"
_HUGE_PAGES = "glibc.malloc.hugetlb=1"
"""Tunable with which malloc requests transparent huge pages. Texture lookups then cause fewer TLB misses, which saves
3-8 % of the rendering time of a frame for 5 MB of memory. Another libc, or a kernel without huge pages, ignores it."""
# madvise is not possible, because Mesa allocates the memory, and its addresses are not known
_FREED_ARRAYS = "glibc.malloc.mmap_threshold=4194304"
"""Tunable with which malloc returns freed arrays of 4 MiB and more, such as the textures of a scene, to the system. A
process that prepares many scenes in turn then takes two thirds of the memory."""


def one_core(environment: Mapping[str, str], many_scenes: bool = False) -> dict[str, str]:
    """Returns the environment of a process that renders on one core; other tunables of glibc are kept.

    Args:
        environment: environment to extend.
        many_scenes: whether the process prepares many scenes in turn.
    """
    ours = [_HUGE_PAGES, *([_FREED_ARRAYS] if many_scenes else [])]
    names = [each.partition("=")[0] for each in ours]
    tuned = [each for each in environment.get(_TUNABLES, "").split(":") if each and each.partition("=")[0] not in names]
    return {**environment, **_THREADS, _TUNABLES: ":".join([*tuned, *ours])}
