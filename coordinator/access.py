"""Who may ask, answer and be seen under which keys, as zenoh reads it: default deny, by common name. Pure.

A host asks under its own name and answers in its own subtree; nobody but the router itself answers for the coordinator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from schemas.identity import Role
from schemas.keys import Verb, bundle_key, scene_pattern, verb_key, verb_pattern

__all__ = ["access_control"]

_ANY_RUN = "*"
_VERBS: Mapping[Role, Sequence[Verb]] = {
    Role.WORKER: (Verb.HELLO, Verb.CLAIM, Verb.BEAT, Verb.DONE, Verb.FAIL, Verb.PROGRESS),
    Role.OPERATOR: (Verb.PROGRESS, Verb.ADMIN),
}
_SERVING = ["declare_queryable", "reply", "liveliness_token"]


def access_control(admitted: Mapping[str, Role]) -> dict[str, Any]:
    """Returns zenoh's `access_control` section.

    Args:
        admitted: common name of a certificate -> what it may do.
    """
    scenes = [scene_pattern(_ANY_RUN)]
    rules = [
        _rule("see-coordinator", "egress", ["declare_queryable"], [verb_pattern(_ANY_RUN), *scenes]),
        _rule("ask-scene", "ingress", ["query"], scenes),
        _rule("tell-scene", "egress", ["reply"], scenes),
    ]
    policies = []
    for name, role in sorted(admitted.items()):
        verbs = [verb_key(_ANY_RUN, name, verb) for verb in _VERBS[role]]
        rules += [_rule(f"ask-{name}", "ingress", ["query"], verbs), _rule(f"tell-{name}", "egress", ["reply"], verbs)]
        granted = ["see-coordinator", f"ask-{name}", f"tell-{name}"]
        if role is Role.WORKER:
            mine = [_subtree(name)]
            rules += [
                _rule(f"serve-{name}", "ingress", _SERVING, mine),
                _rule(f"fetch-{name}", "egress", ["query"], mine),
            ]
            granted += ["ask-scene", "tell-scene", f"serve-{name}", f"fetch-{name}"]
        policies.append({"rules": granted, "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in sorted(admitted)],
        "policies": policies,
    }


def _subtree(name: str) -> str:
    """Returns all keys of all sessions of a host: `HOST.` and whatever tells its starts apart."""
    return bundle_key(_ANY_RUN, f"{name}.$*").rpartition("/")[0] + "/**"


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
