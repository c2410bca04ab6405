"""Every policy that `--policy` can name: built-in ones, a class of the user's, a server. One registry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from factory.eval.driving.policy import BlindPolicy, Policy, PrivilegedPolicy
from factory.eval.policies.bc import BcPolicy, bc_file
from factory.eval.policies.experts import ExpertPolicy
from factory.eval.policies.foreign import load_class, require_module
from factory.eval.policies.outside import Outside
from factory.eval.policies.recorded import PlaybackPolicy, ReplayPolicy
from factory.eval.policies.remote import RemotePolicy
from factory.eval.policies.simple import RandomPolicy, StopPolicy
from schemas.errors import UsageError
from schemas.support.extras import require_package
from schemas.support.suggest import did_you_mean
from schemas.terms import ExpertName

__all__ = [
    "POLICIES",
    "Outside",
    "PolicyEntry",
    "check_name",
    "describe_knowledge",
    "file_of",
    "find_policy",
    "is_foreign",
    "make_policy",
    "renders_apart",
    "require_at_hand",
]

Maker = Callable[[str, Outside], Policy]
"""Takes what stands behind the first colon of the name, and what a policy may need."""


class PolicyEntry(NamedTuple):
    """A kind of policy."""

    make: Maker
    usage: str
    """How it is written after `--policy`."""
    needs_recording: bool = False
    """Whether it carries out actions of archived episodes."""
    reads_instruction: bool = False
    file_of: Callable[[str], Path] | None = None
    """Returns the file that it is made of, from what stands behind the first colon."""
    needs: tuple[str, ...] = ()
    """Optional packages that it imports, as top-level modules."""
    renders_apart: bool = False
    """Whether a separate process renders, because the policy loads libraries that crash in one process with OpenGL's:
    PyTorch, or whatever a class of the user's imports."""


_WIRE = ("websockets", "msgpack")
POLICIES: Mapping[str, PolicyEntry] = MappingProxyType(
    {
        "expert": PolicyEntry(lambda rest, _: ExpertPolicy(_expert_name(rest)), "expert[:NAME]"),
        "planner": PolicyEntry(lambda _rest, _: ExpertPolicy(ExpertName.PLANNER), "planner"),
        "random": PolicyEntry(lambda _rest, _: RandomPolicy(), "random"),
        "stop": PolicyEntry(lambda _rest, _: StopPolicy(), "stop"),
        "replay": PolicyEntry(lambda _rest, _: ReplayPolicy(), "replay", needs_recording=True),
        "playback": PolicyEntry(lambda _rest, _: PlaybackPolicy(), "playback", needs_recording=True),
        "bc": PolicyEntry(lambda rest, _: BcPolicy(rest), "bc:OUT", False, True, bc_file, ("torch",), True),
        "ws": PolicyEntry(
            lambda rest, outside: RemotePolicy(f"ws:{rest}", outside), "ws://HOST:PORT", False, True, None, _WIRE
        ),
        "wss": PolicyEntry(
            lambda rest, outside: RemotePolicy(f"wss:{rest}", outside), "wss://HOST:PORT", False, True, None, _WIRE
        ),
    }
)
"""By the word before the first colon; any other name is taken for `package.module:Class`."""
_FOREIGN = PolicyEntry(
    lambda name, _: load_class(name), "package.module:Class", reads_instruction=True, renders_apart=True
)


def find_policy(name: str) -> PolicyEntry:
    """Returns the kind of a policy without making it.

    Raises:
        UsageError: nothing is called that.
    """
    kind = name.partition(":")[0]
    if kind in POLICIES:
        return POLICIES[kind]
    if ":" not in name or not all(part.isidentifier() for part in name.replace(":", ".").split(".")):
        known = ", ".join(entry.usage for entry in (*POLICIES.values(), _FOREIGN))
        raise UsageError(f"unknown policy {name!r}; built-in policies: {known}{did_you_mean(kind, POLICIES)}")
    return _FOREIGN


def is_foreign(name: str) -> bool:
    """Whether making the policy imports a module of the user's.

    Raises:
        UsageError: nothing is called that.
    """
    return find_policy(name) is _FOREIGN


def renders_apart(name: str) -> bool:
    """Returns whether frames are rendered in a process of their own while the policy of that name drives."""
    return POLICIES.get(name.partition(":")[0], _FOREIGN).renders_apart


def check_name(name: str) -> None:
    """Makes sure that a policy can be called that, without making it.

    Raises:
        UsageError: nothing is called that.
    """
    find_policy(name)
    kind, _, rest = name.partition(":")
    if kind == "expert":
        _expert_name(rest)


def require_at_hand(name: str) -> None:
    """Makes sure that what a policy is made of is on this machine, as far as that can be told without making it.

    Raises:
        UsageError: a package, its file or its module is not there.
    """
    entry = find_policy(name)
    for module in entry.needs:
        require_package(module, f"policy {name}")
    file_of(name)
    if entry is _FOREIGN:
        require_module(name)


def make_policy(name: str, outside: Outside, file: Path | None = None) -> Policy:
    """Returns the policy of that name, ready for its first episode.

    Args:
        name: as after `--policy`.
        outside: what policies may need of their surroundings.
        file: what it is made of, where that is not at the place its name says.

    Raises:
        UsageError: nothing is called that, or it cannot be made; the message says why.
        ServerAway: its server cannot be reached.
    """
    entry = find_policy(name)
    rest = name if entry is _FOREIGN else name.partition(":")[2]
    policy = entry.make(rest if file is None else str(file), outside)
    missing = [method for method in ("reset", "act") if not callable(getattr(policy, method, None))]
    if missing:
        raise UsageError(f"policy {name} has no method {' and no '.join(missing)}; see docs/evaluation/README.md")
    if entry is _FOREIGN and isinstance(policy, PrivilegedPolicy):
        raise UsageError(
            f"policy {name} derives from PrivilegedPolicy, which gives the goal and the map to built-in policies only"
        )
    return policy


def file_of(name: str) -> Path | None:
    """Returns the file that a policy is made of, if it is.

    Raises:
        UsageError: it is not there.
    """
    find = find_policy(name).file_of
    return None if find is None else find(name.partition(":")[2])


def describe_knowledge(policy: Policy) -> str:
    """Returns what a policy goes by, for the results."""
    return policy.knows if isinstance(policy, BlindPolicy) else "camera and instruction"


def _expert_name(rest: str) -> ExpertName:
    try:
        return ExpertName(rest or ExpertName.PROPORTIONAL)
    except ValueError as error:
        known = f"{', '.join(ExpertName)}{did_you_mean(rest, ExpertName)}"
        raise UsageError(f"unknown expert {rest!r}; valid experts: {known}") from error
