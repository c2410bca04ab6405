"""Forks the Python processes that a tested process would start, because the imports of a new interpreter take a second.

A helper process makes the forks. It is a child of the tested process (the owner): either a copy of the owner, made
before the owner starts threads, or a new interpreter. The parent of each fork is the owner and not the helper, so
the forks are real children of the owner. A fork has the arguments, environment, directory, descriptors and session that
the owner requested, and runs its module as `python -m` does. Programs other than Python, and interpreters with other
environment variables, are started as usual.
"""

from __future__ import annotations

import _posixsubprocess
import atexit
import contextlib
import ctypes
import fcntl
import gc
import importlib
import json
import os
import platform
import re
import runpy
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import asdict, dataclass
from multiprocessing.spawn import spawn_main
from pathlib import Path
from typing import Any, NoReturn

from schemas.support.child import SAFE_PATH

NAME = "fork-helper"
"""Name of the helper's process, at most 15 characters."""
VALIDATOR = "coordinator.validation.validator_child"
FORKED = frozenset(
    {
        VALIDATOR,
        "factory",
        "factory.eval.process.child",
        "factory.eval.remote.eval_worker",
        "factory.runs.build_process",
        "factory.web.figures.process",
        "tests.builders.fork_server",
        "tests.builders.script",
        "tests.builders.small_simulation",
        "tests.builders.worker",
        "tests.chaos.host_process",
        "tests.fuzz.child",
        "workers.render.process_child",
        "workers.sim.simulate",
    }
)
"""Modules that are run in forks: modules that the product starts as processes, and modules that tests start."""
_STARTS_NO_PYTHON = frozenset(
    {VALIDATOR, "tests.builders.fork_server", "tests.builders.small_simulation", "workers.render.process_child"}
)
_SPAWNED = re.compile(r"from multiprocessing\.spawn import spawn_main; spawn_main\((\w+)=(\d+), (\w+)=(\d+)\)")
_AT_START = re.compile(r"LD_|PYTHON[A-Z]")
"""Prefixes of variables that the dynamic loader and the interpreter read at their start. Names such as `PYTHON`, which
`make` uses, and `PYTHON_VERSION`, which container images set, do not match. The variables with `PYTHON_` that the
interpreter reads since 3.13 do not match either; they change nothing in a fork."""
_CHANGES_NO_PROGRAM = frozenset({SAFE_PATH, "PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED"})
"""Variables that match `_AT_START` but may differ between the owner and a fork. `make`, CI and images set some of them
for the owner, and the environment of the validator contains none of them."""
NEW_INTERPRETER = "PYTHONNEWINTERPRETER"
"""Variable that a test sets to get new interpreters instead of forks."""
_VALIDATION_BYTES = 512 << 20
"""Address space that a validator needs in addition to the address space of the helper, bytes."""
_LARGEST, _MOST_FDS = 1 << 17, 64
_CLONE = {"x86_64": 56, "aarch64": 220}[platform.machine()]
_CLONE_PARENT = 0x8000
_FORK_EXEC = _posixsubprocess.fork_exec
"""The function that starts a process in `subprocess` and `multiprocessing`."""
_COMM = Path("/proc/self/comm")
_HUGE, _MADV_COLLAPSE = 2 << 20, 25
_call_system = ctypes.PyDLL(None, use_errno=True).syscall
_advise = ctypes.CDLL(None).madvise
_advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)


@dataclass(frozen=True)
class _Order:
    words: list[str]
    """Arguments of the interpreter."""
    environment: dict[str, str]
    folder: str
    targets: list[int]
    """For each descriptor sent with the order, its number in the new process."""
    new_session: bool


class _Helper:
    """The owner's side of the helper."""

    def __init__(self, orders: socket.socket) -> None:
        self._orders, self._lock = orders, threading.Lock()
        ready = orders.recv(32)
        assert ready, "the helper does not start"
        self._bytes = int(ready)

    def has_room(self, words: Sequence[str]) -> bool:
        """Returns whether a fork of the helper leaves a validator enough memory below its limit.

        Returns `True` for every other module, because only validators have a limit.
        """
        if words[3] != VALIDATOR:
            return True
        limits = json.loads(words[4])  # not parsed by the pydantic model, whose import takes longer than most forks
        return bool(limits["memory_bytes"] - self._bytes >= _VALIDATION_BYTES)

    def fork(self, order: _Order, fds: Sequence[int]) -> int:
        """Returns the id of a new child of this process."""
        with self._lock:
            socket.send_fds(self._orders, [json.dumps(asdict(order)).encode()], fds)
            reply = self._orders.recv(32)
        assert reply, f"the helper has ended; {order.words} were requested"
        return int(reply)


def fork_children(modules: Set[str] = FORKED) -> None:
    """Starts the helper of this process; later child processes are forked by it. Call this before threads start.

    Args:
        modules: modules of the children that are forked. Processes of `multiprocessing` are forked too.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    name = _COMM.read_text().rstrip("\n")
    _COMM.write_text(NAME)  # the helper inherits this name
    if os.fork() == 0:
        ours.close()
        _serve(theirs)
    _COMM.write_text(name)
    theirs.close()
    helper = _Helper(ours)
    _replace_start(_Forkable(modules), lambda: helper)


def fork_children_from_interpreter(imports: Sequence[str], modules: Set[str] = FORKED) -> None:
    """Forks the children of this process from a new interpreter; this process may have threads.

    Args:
        imports: modules that the interpreter imports when the first child starts.
        modules: modules of the children that are forked. Processes of `multiprocessing` are forked too.
    """
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    started: list[tuple[_Helper, subprocess.Popen[bytes]]] = []
    lock = threading.Lock()

    def helper() -> _Helper:
        with lock:
            if not started:
                ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                command = [sys.executable, "-m", __name__, str(theirs.fileno()), *imports]
                process = subprocess.Popen(
                    command, env=environment, cwd=Path(__file__).parents[2], pass_fds=(theirs.fileno(),)
                )
                theirs.close()
                started.append((_Helper(ours), process))
                atexit.register(process.wait)
                atexit.register(ours.close)  # this ends the helper
        return started[0][0]

    _replace_start(_Forkable(modules), helper)


def prepare_forks() -> None:
    """Makes later forks of this process cheaper; call it after all imports that the forks need.

    Garbage collections in the forks skip the objects of this process and are less frequent, because collections with
    Python's default thresholds take 3 % of the CPU time of the suite. The memory of this process is moved to huge pages
    if the kernel supports this, because a fork copies the page tables.
    """
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, rights, _, _, inode, *_ = line.split()
        begin, end = (int(address, 16) for address in span.split("-"))
        if inode == "0" and rights == "rw-p":
            for start in range(-(-begin // _HUGE) * _HUGE, end - _HUGE + 1, _HUGE):
                _advise(start, _HUGE, _MADV_COLLAPSE)  # fails for a span without pages and on kernels before 6.1


def end_after(program: Callable[[], object]) -> NoReturn:
    """Calls the program and ends the process as an interpreter does, but does not clear the modules.

    Clearing them would copy the memory shared with the parent, which takes a quarter of a second.
    """
    status = 0
    try:
        program()
    except SystemExit as error:
        if isinstance(error.code, str):
            sys.stderr.write(f"{error.code}\n")
        status = error.code if isinstance(error.code, int) else int(error.code is not None)
    except KeyboardInterrupt:
        traceback.print_exc()
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:  # noqa: BLE001 - as an interpreter does
        traceback.print_exc()
        status = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):
        status = 120
    os._exit(status & 0xFF)


def _read_at_start(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns the environment variables that a process reads only when it starts.

    Directories of a search path that change nothing are excluded: those that do not exist, such as the one that OpenCV
    adds, and those that `sys.path` contains already.
    """
    found = {
        name: value for name, value in environment.items() if _AT_START.match(name) and name not in _CHANGES_NO_PROGRAM
    }
    for name in ("PYTHONPATH", "LD_LIBRARY_PATH"):
        entries = found.pop(name, "").split(os.pathsep)
        if added := [entry for entry in entries if entry not in {"", *sys.path} and Path(entry).exists()]:
            found[name] = os.pathsep.join(added)
    return found


class _Forkable:
    """Set of the commands that a fork can run in place of a new interpreter; empty in a fork of this process."""

    def __init__(self, modules: Set[str]) -> None:
        self._modules, self._owner = modules, os.getpid()
        self._variables = _read_at_start(os.environ)

    def contains(self, words: Sequence[str], environment: Mapping[str, str]) -> bool:
        """Whether the arguments and the variables of a command permit a fork."""
        if os.getpid() != self._owner or words[0] != sys.executable or len(words) < 4:
            return False
        if _read_at_start(environment) != self._variables:
            return False
        if _SPAWNED.fullmatch(words[-2]):
            return True
        return words[1:3] == ["-P", "-m"] and words[3] in self._modules


def _replace_start(forkable: _Forkable, helper: Callable[[], _Helper]) -> None:
    """Replaces the function with which `subprocess` and `multiprocessing` start processes; it forks where possible."""

    def start(args: Sequence[Any], programs: object, *others: Any) -> int:
        (
            (close_fds, kept, folder, variables, stdin, _, _, stdout, _, stderr, _, errors),
            (_, new_session, group, *identity, preexec_fn, _),
        ) = others[:12], others[12:]
        words = [*map(os.fsdecode, args)]
        environment = dict(os.environ) if variables is None else _parse(variables)
        is_plain = close_fds and preexec_fn is None and group == -1 and all(each in (None, -1) for each in identity)
        if not (is_plain and forkable.contains(words, environment) and helper().has_room(words)):
            return _FORK_EXEC(args, programs, *others)
        fds = {fd: fd for fd in kept if fd != errors}
        fds |= {target: target if fd == -1 else fd for target, fd in enumerate((stdin, stdout, stderr))}
        order = _Order(words[1:], environment, os.fsdecode(folder or os.getcwd()), [*fds], bool(new_session))
        return helper().fork(order, [*fds.values()])

    subprocess._fork_exec = _posixsubprocess.fork_exec = start  # type: ignore[attr-defined]


def _parse(variables: Sequence[bytes]) -> dict[str, str]:
    pairs = (os.fsdecode(variable).partition("=") for variable in variables)
    return {name: value for name, _, value in pairs}


def _serve(orders: socket.socket) -> NoReturn:
    """Forks a process for each order of the owner until the owner has ended."""
    group = os.getpgrp()
    os.setpgid(0, 0)  # signals to the owner's group do not reach this process
    _keep_only({orders.fileno(): orders.fileno()})
    orders.send(str(int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")).encode())
    while True:
        data, fds, _, _ = socket.recv_fds(orders, _LARGEST, _MOST_FDS)
        if not data:
            os._exit(0)
        if _fork_sibling() == 0:
            os.setpgid(0, group)
            order = _Order(**json.loads(data))
            _COMM.write_text(_name_of(order))
            orders.send(str(os.getpid()).encode())
            _run(order, fds)
        for fd in fds:
            os.close(fd)


def _fork_sibling() -> int:
    """Forks this process, which must have one thread. The parent of the copy is the parent of this process.

    Raises:
        OSError: the system cannot create a process.
    """
    ctypes.pythonapi.PyOS_BeforeFork()  # `os.fork` calls this too
    pid = int(_call_system(_CLONE, _CLONE_PARENT, 0, 0, 0, 0))
    if pid == 0:
        ctypes.pythonapi.PyOS_AfterFork_Child()
        return 0
    ctypes.pythonapi.PyOS_AfterFork_Parent()
    if pid < 0:
        raise OSError(ctypes.get_errno(), "clone")
    return pid


def _name_of(order: _Order) -> str:
    if order.words[1] != "-m":
        return "spawned"
    module, *words = order.words[2:]
    return words[0] if module == "factory" else module.rpartition(".")[2]


def _run(order: _Order, fds: Sequence[int]) -> NoReturn:
    """Runs the ordered program in this process."""
    if order.new_session:
        os.setsid()
    _keep_only(dict(zip(order.targets, fds, strict=True)))
    os.chdir(order.folder)
    os.environ.clear()
    os.environ.update(order.environment)
    if spawned := _SPAWNED.fullmatch(order.words[-2]):
        fork_children()
        numbers = {spawned[1]: int(spawned[2]), spawned[3]: int(spawned[4])}
        sys.argv = ["-c", order.words[-1]]
        end_after(lambda: spawn_main(**numbers))
    module, *words = order.words[2:]
    if module not in _STARTS_NO_PYTHON:
        fork_children()
    sys.argv = [module, *words]
    for name in (module, f"{module}.__main__"):  # `runpy` warns if the module is imported already
        if not hasattr(sys.modules.get(name), "__path__"):
            sys.modules.pop(name, None)
    end_after(lambda: runpy.run_module(module, run_name="__main__", alter_sys=True))


def _keep_only(fds: Mapping[int, int]) -> None:
    """Renumbers descriptors to the keys of `fds` and closes all others; missing standard streams become /dev/null."""
    first = max(fds, default=2) + 1
    copies = {target: fcntl.fcntl(fd, fcntl.F_DUPFD, first) for target, fd in fds.items()}
    nowhere = os.open(os.devnull, os.O_RDWR)
    for target in {0, 1, 2} - {*fds}:
        os.dup2(nowhere, target)
    for target, copy in copies.items():
        os.dup2(copy, target)
    for name in os.listdir("/proc/self/fd"):
        if int(name) not in {0, 1, 2, *fds}:
            with contextlib.suppress(OSError):
                os.close(int(name))


if __name__ == "__main__":
    for each in sys.argv[2:]:
        importlib.import_module(each)
    prepare_forks()
    _COMM.write_text(NAME)
    _serve(socket.socket(fileno=int(sys.argv[1])))
