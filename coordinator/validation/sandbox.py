"""Sandboxes a validating process before it reads a bundle, with resource limits and a system call filter.

With seccomp (the package `pyseccomp` and the system's libseccomp) the process cannot open files or sockets, start
programs, send signals or map executable memory. It reads open descriptors that it receives and replies through a pipe.
Other system calls fail with EPERM. The sandbox needs no privileges and works inside containers.

Design: docs/design/protocol.md#the-validator-gets-open-files.
"""

from __future__ import annotations

import errno
import mmap
import resource
from typing import Any

RLIMITS, SECCOMP = "rlimits", "seccomp"
_AT_EMPTY_PATH = 0x1000
_UNCONDITIONAL = (
    *("read", "pread64", "readv", "lseek", "write", "writev", "close", "fstat", "recvfrom", "recvmsg"),
    *("brk", "munmap", "mremap", "madvise", "futex", "sched_yield", "sched_getaffinity", "getrandom"),
    *("clock_gettime", "clock_getres", "gettimeofday", "getrusage", "getpid", "gettid", "sysinfo"),
    *("rt_sigaction", "rt_sigprocmask", "rt_sigreturn", "sigaltstack", "restart_syscall", "exit", "exit_group"),
)
"""System calls that are allowed with any arguments."""


def confine(memory_bytes: int) -> tuple[str, ...]:
    """Applies the sandbox to this process permanently.

    Args:
        memory_bytes: limit of the address space, bytes.

    Returns:
        The active layers: `RLIMITS`, and `SECCOMP` if library and kernel support it.
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
    except OSError:  # the kernel or the container does not support filters
        return False
    return True


def _allow(rules: Any, seccomp: Any) -> None:
    for name in _UNCONDITIONAL:
        rules.add_rule(seccomp.ALLOW, name)
    arg = seccomp.Arg
    for name in ("mmap", "mprotect"):
        rules.add_rule(seccomp.ALLOW, name, arg(2, seccomp.MASKED_EQ, mmap.PROT_EXEC, 0))
    # glibc calls newfstatat for fstat
    rules.add_rule(seccomp.ALLOW, "newfstatat", arg(3, seccomp.MASKED_EQ, _AT_EMPTY_PATH, _AT_EMPTY_PATH))
    # the process raises its own CPU time limit before every task
    own_cpu = (arg(0, seccomp.EQ, 0), arg(1, seccomp.EQ, resource.RLIMIT_CPU))
    rules.add_rule(seccomp.ALLOW, "prlimit64", *own_cpu)
