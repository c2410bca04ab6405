"""Simulation process of a round of corrections (`python -m factory.correct.simulate`), which a worker starts.

It is the simulation process of demonstrations with a policy. With `--describe`, it creates the policy, prints the
digest of what it consists of, and exits.
"""

from __future__ import annotations

# isort: off
import workers.sim.simulate as simulation  # sets the number of threads before numpy is imported

# isort: on
import argparse
import os
import sys
from typing import cast

from factory.correct.driver import EvaluatedPolicy
from factory.eval.models.messages import PolicyLimits
from factory.eval.policies.registry import renders_apart
from schemas.errors import FactoryError, UsageError
from schemas.terms import FailReason, RendererKind
from workers.process.messages import failure


def main() -> int:
    """Serves orders until stdin closes, or describes the policy."""
    parser = argparse.ArgumentParser(prog="factory.correct.simulate", description="Simulates corrections of a policy.")
    parser.add_argument("--renderer", choices=("auto", "gl", "tiny"), default="auto")
    parser.add_argument("--policy", required=True)
    parser.add_argument("--act-timeout", type=float, required=True)
    parser.add_argument("--load-timeout", type=float, required=True)
    parser.add_argument("--describe", action="store_true")
    arguments = parser.parse_args()
    limits = PolicyLimits(act_timeout_s=arguments.act_timeout, load_timeout_s=arguments.load_timeout)
    if arguments.describe:
        return _describe(arguments.policy, limits)

    def open_driver(send: simulation.SendReport) -> EvaluatedPolicy:
        return EvaluatedPolicy(arguments.policy, limits, lambda detail: send(failure(FailReason.POLICY, detail)))

    renderer = cast(RendererKind, arguments.renderer)
    return simulation.serve(renderer, open_driver, apart=renders_apart(arguments.policy))


def _describe(name: str, limits: PolicyLimits) -> int:
    try:
        made_from = EvaluatedPolicy(name, limits, lambda detail: print(detail, file=sys.stderr)).made_from  # noqa: T201
    except FactoryError as error:
        print(error, file=sys.stderr)  # noqa: T201 - the command shows the last line
        return 2 if isinstance(error, UsageError) else 1
    print(made_from)  # noqa: T201 - the result, for the command
    return 0


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # a normal exit would wait for the thread that reads orders
