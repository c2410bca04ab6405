"""Confines a validating process before it reads a bundle: resource limits, and no system call that it does not need.

With seccomp (the package `pyseccomp` and the system's libseccomp) the process opens no file and no socket, starts no
program, signals nobody and maps no new code; it reads what it is handed as open descriptors and answers through a pipe.
A system call outside the list fails with EPERM. Works without privileges and inside containers.
"""

from __future__ import annotations

import errno
import mmap
import resource
from typing import Any

__all__ = ["RLIMITS", "SECCOMP", "confine"]

RLIMITS, SECCOMP = "rlimits", "seccomp"
_AT_EMPTY_PATH = 0x1000
_ANYHOW = (
    *("read", "pread64", "readv", "lseek", "write", "writev", "close", "fstat", "recvfrom", "recvmsg"),
    *("brk", "munmap", "mremap", "madvise", "futex", "sched_yield", "sched_getaffinity", "getrandom"),
    *("clock_gettime", "clock_getres", "gettimeofday", "getrusage", "getpid", "gettid", "sysinfo"),
    *("rt_sigaction", "rt_sigprocmask", "rt_sigreturn", "sigaltstack", "restart_syscall", "exit", "exit_group"),
)
"""Allowed with any arguments: reading, answering, memory, time, the end."""


def confine(memory_bytes: int) -> tuple[str, ...]:
    """Confines this process for the rest of its life.

    Args:
        memory_bytes: largest address space.

    Returns:
        What is in force: `RLIMITS`, and `SECCOMP` where library and kernel have it.
    """
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    return (RLIMITS, SECCOMP) if _filter_system_calls() else (RLIMITS,)


def _filter_system_calls() -> bool:
    try:
        import pyseccomp as seccomp
    except (ImportError, OSError, RuntimeError):  # the package, or the system's library, is not installed
        return False
    try:
        rules = seccomp.SyscallFilter(seccomp.ERRNO(errno.EPERM))
        rules.set_attr(seccomp.Attr.CTL_TSYNC, 1)
        _allow(rules, seccomp)
        rules.load()
    except OSError:  # the kernel, or the container around us, has no filters
        return False
    return True


def _allow(rules: Any, seccomp: Any) -> None:
    for name in _ANYHOW:
        rules.add_rule(seccomp.ALLOW, name)
    arg = seccomp.Arg
    for name in ("mmap", "mprotect"):
        rules.add_rule(seccomp.ALLOW, name, arg(2, seccomp.MASKED_EQ, mmap.PROT_EXEC, 0))
    # how glibc asks for the state of an open descriptor
    rules.add_rule(seccomp.ALLOW, "newfstatat", arg(3, seccomp.MASKED_EQ, _AT_EMPTY_PATH, _AT_EMPTY_PATH))
    # this process's own limit of CPU time, which rises with every task
    own_cpu = (arg(0, seccomp.EQ, 0), arg(1, seccomp.EQ, resource.RLIMIT_CPU))
    rules.add_rule(seccomp.ALLOW, "prlimit64", *own_cpu)
