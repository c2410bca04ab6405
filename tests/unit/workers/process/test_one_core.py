"""The environment of a process that renders on one core."""

from __future__ import annotations

from workers.process.one_core import one_core


def test_threads_are_disabled_and_the_rest_of_the_environment_is_kept() -> None:
    assert one_core({"HOME": "/home/ada", "LP_NUM_THREADS": "8"}) == {
        "HOME": "/home/ada",
        "LP_NUM_THREADS": "0",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
    }


def test_other_glibc_tunables_are_kept() -> None:
    tuned = one_core({"GLIBC_TUNABLES": "glibc.malloc.check=3:glibc.malloc.hugetlb=0"})
    assert tuned["GLIBC_TUNABLES"] == "glibc.malloc.check=3:glibc.malloc.hugetlb=1"


def test_applying_the_settings_twice_has_no_effect() -> None:
    assert one_core(one_core({})) == one_core({})


def test_a_process_of_many_scenes_returns_the_memory_of_freed_arrays_to_the_system() -> None:
    tuned = one_core({"GLIBC_TUNABLES": "glibc.malloc.mmap_threshold=1:glibc.malloc.check=3"}, many_scenes=True)
    assert tuned["GLIBC_TUNABLES"] == (
        "glibc.malloc.check=3:glibc.malloc.hugetlb=1:glibc.malloc.mmap_threshold=4194304"
    )
