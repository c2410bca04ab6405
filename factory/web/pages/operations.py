"""Operations on a run: each has a page that explains it, asks for confirmation, and shows the result."""

from __future__ import annotations

from types import MappingProxyType

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.export.execution.selection import parse_episodes
from factory.web.context import WebContext, context_of, page
from factory.web.forms import read_form
from schemas.errors import FactoryError, UsageError
from schemas.job import episode_id, index_of_file
from schemas.protocol.administration import MAX_INDICES, AdminAction, AdminReply, AdminRequest

_TEXTS = MappingProxyType(
    {
        AdminAction.RETRY: "Puts failed or cancelled episodes back into the queue.",
        AdminAction.CANCEL: "Cancels episodes that have not ended. Workers stop them at their next heartbeat.",
        AdminAction.DRAIN: "Lets every worker finish its current jobs and exit; new workers exit too, until "
        "the coordinator is restarted. Needs a running coordinator.",
        AdminAction.PAUSE: "Leases no more jobs until the run is resumed. Running jobs continue.",
        AdminAction.RESUME: "Leases jobs again.",
        AdminAction.RELEASE: "Assigns jobs to all barred and limited hosts again.",
    }
)
"""Effect of each operation."""
_OF_EPISODES = (AdminAction.RETRY, AdminAction.CANCEL)
_NAMED = 20


def routes() -> list[Route]:
    return [Route("/operations/{action}", operate, methods=["GET", "POST"])]


async def operate(request: Request) -> Response:
    """Answers with the page of an operation; a confirmed form executes it."""
    try:
        action = AdminAction(request.path_params["action"])
    except ValueError as error:
        valid = ", ".join(AdminAction)
        raise HTTPException(404, f"the operation does not exist; valid operations: {valid}") from error
    if request.method != "POST":
        return _page(request, action, None)
    fields = await read_form(request)
    if fields.get("confirm") != "1":
        return _page(request, action, "Confirm the operation first.", 400)
    try:
        reply = await run_in_threadpool(_execute, context_of(request), _request(action, fields))
    except FactoryError as error:
        return _page(request, action, str(error), 400 if isinstance(error, UsageError) else 503)
    return _page(request, action, _describe(action, reply))


def _execute(context: WebContext, request: AdminRequest) -> AdminReply:
    """Executes a request on the run. Then discards the shared content of the farm page, so it shows the new state."""
    try:
        return context.administer(request)
    finally:
        context.farm.forget()


def _request(action: AdminAction, fields: dict[str, str]) -> AdminRequest:
    if action not in _OF_EPISODES:
        return AdminRequest(action=action)
    text, is_all = fields.get("episodes", "").strip(), fields.get("all") == "1"
    if bool(text) == is_all:
        raise UsageError("give either episodes, for example 1-50,60, or choose all")
    indices = tuple(index_of_file(f"{name}.zip") or 0 for name in parse_episodes(text)) if text else ()
    if len(indices) > MAX_INDICES:
        raise UsageError(f"{len(indices)} episodes were given; give at most {MAX_INDICES}, or choose all")
    return AdminRequest(action=action, indices=indices)


def _describe(action: AdminAction, reply: AdminReply) -> str:
    names = [*map(episode_id, reply.changed[:_NAMED]), *reply.hosts[:_NAMED]]
    count = len(reply.changed) + len(reply.hosts)
    refused = "; ".join(f"{episode_id(index)}: {reason}" for index, reason in list(reply.refused.items())[:_NAMED])
    if action in (AdminAction.DRAIN, AdminAction.PAUSE, AdminAction.RESUME):
        return f"{action}: done"
    return f"{action}: {count} changed ({', '.join(names) or 'none'})" + (f"; refused: {refused}" if refused else "")


def _page(request: Request, action: AdminAction, result: str | None, status: int = 200) -> Response:
    return page(
        request,
        "operation",
        f"{action.capitalize()}",
        status,
        action=str(action),
        text=_TEXTS[action],
        takes_episodes=action in _OF_EPISODES,
        episodes=request.query_params.get("episodes", "")[:200],
        result=result,
    )
