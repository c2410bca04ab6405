"""Generates zenoh's access control rules: default deny, by common name of the certificate. Opens no session.

A host may send requests under its own name and serve keys in its own subtree. Only the router replies for the
coordinator. A gateway also forwards the requests of its workers under their names, because it has admitted them by
their certificates. An evaluator replies to requests about evaluations and has no access to the coordinator's own run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from schemas.protocol.identity import Role
from schemas.protocol.keys import (
    EVALUATION_RUNS,
    Verb,
    alive_pattern,
    bundle_key,
    scene_pattern,
    verb_key,
    verb_pattern,
)

_ANY_RUN, _ANY_HOST, _ANY_SID = "*", "*", "*"
_VERBS: Mapping[Role, Sequence[Verb]] = {
    Role.WORKER: (Verb.HELLO, Verb.CLAIM, Verb.BEAT, Verb.DONE, Verb.FAIL, Verb.PROGRESS),
    Role.OPERATOR: (Verb.PROGRESS, Verb.ADMIN),
    Role.GATEWAY: (Verb.JOIN, Verb.ORDERS, Verb.HOLD, Verb.ARCHIVED, Verb.REFUSED, Verb.INVENTORY),
    Role.EVALUATOR: (),
}
"""Verbs of each role, besides `ping`, which every role may send to learn its role."""
_SERVING = ["declare_queryable", "reply", "liveliness_token"]


def roles_with(verb: Verb) -> tuple[Role, ...]:
    """Returns the roles that may send a verb."""
    return tuple(role for role, verbs in _VERBS.items() if verb in verbs or verb is Verb.PING)


def access_control(admitted: Mapping[str, Role]) -> dict[str, Any]:
    """Returns the `access_control` section of a zenoh configuration.

    Args:
        admitted: mapping of common name to role. Only the list of a gateway contains the role of a coordinator.
    """
    rules = list(_SHARED)
    policies = []
    for name, role in sorted(admitted.items()):
        own_rules, shared = _granted(name, role)
        rules += own_rules
        policies.append({"rules": [*shared, *(rule["id"] for rule in own_rules)], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in sorted(admitted)],
        "policies": policies,
    }


def _granted(name: str, role: Role) -> tuple[list[dict[str, Any]], Sequence[str]]:
    """Returns the rules of one name, and the ids of the shared rules that apply to it."""
    if role is Role.COORDINATOR:
        return [], _OF_CORE
    verbs = [verb_key(_ANY_RUN, name, verb) for verb in (*_VERBS[role], Verb.PING)]
    rules = [_rule(f"ask-{name}", "ingress", ["query"], verbs), _rule(f"tell-{name}", "egress", ["reply"], verbs)]
    if role is Role.OPERATOR:
        return rules, _OF_ALL
    if role is Role.GATEWAY:
        return rules, (*_OF_ALL, *_OF_SCENES, *_OF_GATEWAYS)
    if role is Role.EVALUATOR:
        return rules, (*_OF_ALL, *_OF_EVALUATORS)
    mine = [_subtree(name)]
    rules += [_rule(f"serve-{name}", "ingress", _SERVING, mine), _rule(f"fetch-{name}", "egress", ["query"], mine)]
    return rules, (*_OF_ALL, *_OF_SCENES)


def _subtree(name: str) -> str:
    """Returns the pattern of all keys of all sessions of a host; session ids begin with `HOST.`."""
    return bundle_key(_ANY_RUN, f"{name}.$*").rpartition("/")[0] + "/**"


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


_SCENES = [scene_pattern(_ANY_RUN)]
_ANSWERED = [verb_pattern(_ANY_RUN), *_SCENES]
_PASSED_ON = [verb_key(_ANY_RUN, _ANY_HOST, verb) for verb in _VERBS[Role.WORKER]]
_TOKENS = [alive_pattern(_ANY_RUN)]
_LENT_ANSWERS = [verb_pattern(EVALUATION_RUNS), scene_pattern(EVALUATION_RUNS)]
_LENT_BUNDLES = [bundle_key(EVALUATION_RUNS, _ANY_SID)]
_SHARED = (
    _rule("see-coordinator", "egress", ["declare_queryable"], _ANSWERED),
    _rule("ask-scene", "ingress", ["query"], _SCENES),
    _rule("tell-scene", "egress", ["reply"], _SCENES),
    _rule("pass-on", "ingress", ["query"], _PASSED_ON),
    _rule("pass-back", "egress", ["reply"], _PASSED_ON),
    _rule("see-workers", "ingress", ["liveliness_token"], _TOKENS),
    _rule("believe-core", "ingress", ["declare_queryable", "reply"], _ANSWERED),
    _rule("ask-core", "egress", ["query"], _ANSWERED),
    _rule("show-workers", "egress", ["liveliness_token"], _TOKENS),
    _rule("believe-evaluator", "ingress", ["declare_queryable", "reply"], _LENT_ANSWERS),
    _rule("ask-evaluator", "egress", ["query"], [*_PASSED_ON, *_SCENES]),
    _rule("lend-workers", "egress", ["declare_queryable", "reply"], _LENT_BUNDLES),
    _rule("ask-lent", "ingress", ["query"], _LENT_BUNDLES),
    _rule("believe-lent", "ingress", ["declare_queryable", "reply"], _LENT_BUNDLES),
    _rule("fetch-lent", "egress", ["query"], _LENT_BUNDLES),
)
_OF_ALL = ("see-coordinator",)
_OF_SCENES = ("ask-scene", "tell-scene")
_OF_GATEWAYS = ("pass-on", "pass-back", "see-workers", "believe-lent", "fetch-lent")
_OF_CORE = ("believe-core", "ask-core", "show-workers", "lend-workers", "ask-lent")
_OF_EVALUATORS = ("believe-evaluator", "ask-evaluator", "show-workers", "lend-workers", "ask-lent")
