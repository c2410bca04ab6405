"""List of the datasets of a folder, with a picture of each."""

from __future__ import annotations

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.web.context import page
from factory.web.folder import MOST_DATASETS, DatasetFolder
from factory.web.frames import TooBusy
from factory.web.thumbnails import THUMBNAIL_PX


def routes() -> list[Route]:
    return [Route("/", show), Route("/pictures/{name}", show_picture)]


def show(request: Request) -> Response:
    """Answers with the list."""
    folder: DatasetFolder = request.app.state.context
    entries, total = folder.entries(), folder.count()
    hidden = max(0, total - MOST_DATASETS)
    return page(request, "datasets", "Datasets", entries=entries, total=total, hidden=hidden, side_px=THUMBNAIL_PX)


def show_picture(request: Request) -> Response:
    """Answers with the first frame of a dataset. Browsers keep it, because its URL on the page names its content."""
    folder: DatasetFolder = request.app.state.context
    try:
        data = folder.picture(folder.first_episode(request.path_params["name"]))
    except TooBusy as error:
        raise HTTPException(503, str(error), {"retry-after": "1"}) from error
    lasting = "private, max-age=31536000, immutable" if "of" in request.query_params else "private, max-age=60"
    return Response(data, media_type="image/jpeg", headers={"cache-control": lasting})
