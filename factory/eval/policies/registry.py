"""Registry of the policies for `--policy`: built-in policies, user classes, policy servers; metadata of a policy.

Runs no episodes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from pydantic import Field

from factory.eval.driving.live_view import live_arrays, shows_recorded_camera
from factory.eval.driving.policy import BlindPolicy, Policy, PrivilegedPolicy, needs_of
from factory.eval.models.messages import EvalReport, EvalTask, PolicyLimits
from factory.eval.models.result import TrainingNote
from factory.eval.policies.bc import BcPolicy, bc_file
from factory.eval.policies.remote import RemotePolicy
from factory.eval.policies.simple import ExpertPolicy, PlaybackPolicy, RandomPolicy, ReplayPolicy, StopPolicy
from factory.eval.policies.user_class import load_class, require_module
from schemas.base import Model
from schemas.config import CameraConfig
from schemas.dataset.meta import software_versions
from schemas.errors import UsageError
from schemas.rig import Rig
from schemas.support.extras import require_package
from schemas.support.suggest import did_you_mean
from schemas.terms import ExpertName


class PolicyNote(Model):
    """Metadata stored next to the results of a policy."""

    policy: str
    reference: str = Field(default="", exclude_if=lambda it: not it)
    """What a policy with a separate name refers to, such as `ws://HOST:PORT`; empty and omitted without a name."""
    knows: str
    reads_instruction: bool
    renderer: str
    software: dict[str, str]
    made_from: dict[str, str] = Field(default={}, max_length=1001, exclude_if=lambda it: not it)
    """SHA-256 of each file of the policy, or of its server's greeting; omitted for built-in policies without a file,
    and in results of older versions."""
    training: TrainingNote | None = Field(default=None, exclude_if=lambda it: it is None)
    """Training of the policy; `None` and omitted if it is not known."""
    order_dependence: str | None = Field(default=None, exclude_if=lambda it: it is None)
    """How an episode that was repeated alone in a new process differs from its result; null and omitted if it does not
    differ, or if none was repeated."""


def note_of(task: EvalTask, made: EvalReport, renderer: str) -> PolicyNote:
    """Returns the metadata of the policy of a task from the report of its creation on this machine."""
    return PolicyNote(
        policy=task.policy,
        reference="" if task.reference == task.policy else task.reference,
        knows=made.detail,
        reads_instruction=find_policy(task.reference).reads_instruction,
        renderer=renderer,
        software=software_versions(),
        made_from=made.made_from,
        training=made.training,
    )


__all__ = [
    "POLICIES",
    "PolicyEntry",
    "check_name",
    "describe_knowledge",
    "file_of",
    "find_policy",
    "is_user_class",
    "make_policy",
    "named",
    "renders_apart",
    "require_available",
    "require_inputs",
]

PolicyFactory = Callable[[str, PolicyLimits], Policy]
"""Creates a policy from the text after the first colon of its name and the time limits."""
_WIRE = ("websockets", "msgpack")
_NAMED = re.compile(r"([A-Za-z0-9][\w .+-]{0,59})=(.+)", re.ASCII)
"""`NAME=REFERENCE`; no reference begins like this, because a colon is before any `=` in it."""


class PolicyEntry(NamedTuple):
    """Registry entry of a kind of policy."""

    make: PolicyFactory
    usage: str
    """Form of the policy name, such as `ws://HOST:PORT`."""
    needs_recording: bool = False
    """Whether the policy replays actions of archived episodes."""
    reads_instruction: bool = False
    file_of: Callable[[str], Path] | None = None
    """Function that returns the file of the policy from the text after the first colon; `None` without a file."""
    needs: tuple[str, ...] = ()
    """Optional packages that the policy imports, as top-level modules."""
    renders_apart: bool = False
    """Whether a separate process renders, because the policy can load libraries, such as PyTorch, that crash in one
    process with the OpenGL libraries."""


POLICIES: Mapping[str, PolicyEntry] = MappingProxyType(
    {
        "expert": PolicyEntry(lambda rest, _: ExpertPolicy(_expert_name(rest)), "expert[:NAME]"),
        "planner": PolicyEntry(lambda _rest, _: ExpertPolicy(ExpertName.PLANNER), "planner"),
        "random": PolicyEntry(lambda _rest, _: RandomPolicy(), "random"),
        "stop": PolicyEntry(lambda _rest, _: StopPolicy(), "stop"),
        "replay": PolicyEntry(lambda _rest, _: ReplayPolicy(), "replay", needs_recording=True),
        "playback": PolicyEntry(lambda _rest, _: PlaybackPolicy(), "playback", needs_recording=True),
        "bc": PolicyEntry(
            lambda rest, _: BcPolicy(rest),
            "bc:OUT",
            needs_recording=False,
            reads_instruction=True,
            file_of=bc_file,
            needs=("torch",),
            renders_apart=True,
        ),
        "ws": PolicyEntry(
            lambda rest, limits: RemotePolicy(f"ws:{rest}", limits),
            "ws://HOST:PORT",
            needs_recording=False,
            reads_instruction=True,
            file_of=None,
            needs=_WIRE,
        ),
        "wss": PolicyEntry(
            lambda rest, limits: RemotePolicy(f"wss:{rest}", limits),
            "wss://HOST:PORT",
            needs_recording=False,
            reads_instruction=True,
            file_of=None,
            needs=_WIRE,
        ),
    }
)
"""Registry by the text before the first colon; any other name means `package.module:Class`."""
_USER_CLASS = PolicyEntry(
    lambda name, _: load_class(name), "package.module:Class", reads_instruction=True, renders_apart=True
)


def named(text: str) -> tuple[str, str]:
    """Returns name and reference of a value of `--policy`, which is `NAME=REFERENCE`, or a reference that is the name.

    Raises:
        UsageError: The name is that of a built-in policy, so tables would be misread.
    """
    match = _NAMED.fullmatch(text)
    if match is None:
        return text, text
    name, reference = match.groups()
    if name in POLICIES and reference != name:
        raise UsageError(f"--policy {text}: {name} is a built-in policy; choose another name for {reference}")
    return name, reference


def find_policy(name: str) -> PolicyEntry:
    """Returns the registry entry of a policy reference; creates no policy.

    Raises:
        UsageError: The name is not valid.
    """
    kind = name.partition(":")[0]
    if kind in POLICIES:
        return POLICIES[kind]
    if ":" not in name or not all(part.isidentifier() for part in name.replace(":", ".").split(".")):
        known = ", ".join(entry.usage for entry in (*POLICIES.values(), _USER_CLASS))
        raise UsageError(f"unknown policy {name!r}; built-in policies: {known}{did_you_mean(kind, POLICIES)}")
    return _USER_CLASS


def is_user_class(name: str) -> bool:
    """Returns whether the policy is a user class, so creating it imports a user module.

    Raises:
        UsageError: The name is not valid.
    """
    return find_policy(name) is _USER_CLASS


def renders_apart(name: str) -> bool:
    """Returns whether a separate process renders the frames for the policy with this name."""
    return POLICIES.get(name.partition(":")[0], _USER_CLASS).renders_apart


def check_name(name: str) -> None:
    """Raises an error unless a policy name is valid; creates no policy.

    Raises:
        UsageError: The name is not valid.
    """
    find_policy(name)
    kind, _, rest = name.partition(":")
    if kind == "expert":
        _expert_name(rest)


def require_available(name: str) -> None:
    """Raises an error unless the packages, the file and the module of a policy are installed; creates no policy.

    Raises:
        UsageError: A package, the file or the module is missing.
    """
    entry = find_policy(name)
    for module in entry.needs:
        require_package(module, f"policy {name}")
    file_of(name)
    if entry is _USER_CLASS:
        require_module(name)


def make_policy(name: str, limits: PolicyLimits, file: Path | None = None) -> Policy:
    """Creates the policy with a name.

    Args:
        name: Name, in the form of a value of `--policy`.
        limits: Time limits.
        file: File of the policy, if it is not at the path in the name.

    Raises:
        UsageError: The name is not valid, or creating the policy failed; the message contains the reason.
        ServerUnreachable: The server of the policy cannot be reached.
    """
    entry = find_policy(name)
    rest = name if entry is _USER_CLASS else name.partition(":")[2]
    policy = entry.make(rest if file is None else str(file), limits)
    missing = [method for method in ("reset", "act") if not callable(getattr(policy, method, None))]
    if missing:
        raise UsageError(f"policy {name} has no method {' and no '.join(missing)}; see docs/evaluation/README.md")
    if entry is _USER_CLASS and isinstance(policy, PrivilegedPolicy):
        raise UsageError(
            f"policy {name} derives from PrivilegedPolicy, which gives the goal and the map to built-in policies only"
        )
    return policy


def require_inputs(name: str, policy: Policy, rig: Rig | None, camera: CameraConfig) -> None:
    """Raises an error unless the robot has all inputs that a policy needs.

    Args:
        name: Name of the policy.
        policy: Policy.
        rig: Rig of the robot; `None` for the recorded camera.
        camera: Recorded camera.

    Raises:
        UsageError: An input is missing.
    """
    given = ["state", *(("rgb", "depth") if shows_recorded_camera(rig, camera) else ())]
    for sensor in rig.sensors if rig else ():
        given += [sensor.name, *(f"{sensor.name}/{array}" for array in live_arrays(sensor))]
    missing = [need for need in needs_of(policy) if need not in given]
    if missing:
        what = "the recorded camera" if rig is None else f"rig {rig.name!r}"
        remedy = (
            "omit --rig, or use --rig paper" if {"rgb", "depth"} & {*missing} else "give --rig RIG with that sensor"
        )
        raise UsageError(
            f"policy {name} needs {', '.join(missing)}, which {what} does not provide; available inputs: "
            f"{', '.join(given)}: {remedy}"
        )


def file_of(name: str) -> Path | None:
    """Returns the file of a policy, or `None` for policies without a file.

    Raises:
        UsageError: The file does not exist.
    """
    find = find_policy(name).file_of
    return None if find is None else find(name.partition(":")[2])


def describe_knowledge(policy: Policy) -> str:
    """Returns a description of the information that a policy uses, for the results."""
    return policy.knows if isinstance(policy, BlindPolicy | BcPolicy) else "camera, instruction and odometry"


def _expert_name(rest: str) -> ExpertName:
    try:
        return ExpertName(rest or ExpertName.PROPORTIONAL)
    except ValueError as error:
        known = f"{', '.join(ExpertName)}{did_you_mean(rest, ExpertName)}"
        raise UsageError(f"unknown expert {rest!r}; valid experts: {known}") from error
