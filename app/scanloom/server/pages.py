"""The server's own pages: the start page, and the page of a link to a view.

The start page is viser's, whose single file holds its scripts and styles, with ScanLoom's name and
icon, and with a style and a script that come before viser's.
"""

import base64
import gzip
import json
from functools import cache
from http import HTTPStatus
from pathlib import Path
from urllib.parse import parse_qs

import viser
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from scanloom.page.layout import scene_place_css
from scanloom.resources import static_path

LINK_KEY = "link"
LINK_PATH = "/go"
# Longer than any link to a view; websockets limits the request line to 8192 bytes.
_MAX_LINK_CHARACTERS = 6_000
_HTML = "text/html; charset=utf-8"


def own_page(request: Request) -> Response | None:
    """The response to a request for a page of ScanLoom's own, None for any other path."""
    make = {"/": _start_page, LINK_PATH: _link_page}.get(path_of(request))
    return None if make is None else make(request)


def text_response(status: HTTPStatus, text: str) -> Response:
    """A response of one line of plain text."""
    return _response(status, "text/plain; charset=utf-8", f"{text}\n".encode())


def path_of(request: Request) -> str:
    """The path of a request without its query."""
    return request.path.partition("?")[0]


def query_value(request: Request, name: str) -> str | None:
    """The value of ``name`` in the query, None unless it occurs exactly once."""
    values = parse_qs(request.path.partition("?")[2]).get(name, [])
    return values[0] if len(values) == 1 else None


def prepare_start_page() -> None:
    """Compress the start page, for which its first reader would wait."""
    _compressed_start_page()


def _start_page(request: Request) -> Response:
    is_compressed = "gzip" in request.headers.get("Accept-Encoding", "")
    body = _compressed_start_page() if is_compressed else _start_html().encode()
    response = _response(HTTPStatus.OK, _HTML, body)
    if is_compressed:
        response.headers["Content-Encoding"] = "gzip"
    return response


@cache
def _compressed_start_page() -> bytes:
    return gzip.compress(_start_html().encode())


def _start_html() -> str:
    html = Path(viser.__file__).with_name("client").joinpath("build/index.html").read_text("utf-8")
    icon = base64.b64encode(static_path("logo.svg").read_bytes()).decode()
    script = static_path("start.js").read_text("utf-8")
    head = (
        f"<title>ScanLoom</title><style data-before-docks>{scene_place_css()}</style>"
        f"<script>{script}</script>"
    )
    # Of several titles in a page the first counts, of several icons the last.
    html = html.replace("<head>", f"<head>{head}", 1)
    link = f'<link rel="icon" type="image/svg+xml" href="data:image/svg+xml;base64,{icon}"/>'
    return html.replace("</head>", f"{link}</head>", 1)


def _link_page(request: Request) -> Response:
    """The page of a link: stores the view in local storage, and opens the workbench."""
    view = query_value(request, "view")
    if view is None or len(view) > _MAX_LINK_CHARACTERS:
        return text_response(
            HTTPStatus.BAD_REQUEST, "This link holds no view. Copy it again, whole."
        )
    # An unescaped "</script>" would end the script.
    value = json.dumps(view).replace("<", "\\u003c")
    page = (
        "<!doctype html><meta charset=utf-8><title>ScanLoom</title><script>"
        f"localStorage.setItem('viser-user:{LINK_KEY}', {value});"
        "location.replace('/');</script>"
    )
    return _response(HTTPStatus.OK, _HTML, page.encode())


def _response(status: HTTPStatus, kind: str, body: bytes) -> Response:
    headers = Headers()
    headers["Content-Type"] = kind
    headers["Content-Length"] = str(len(body))
    headers["Cache-Control"] = "no-store"
    return Response(status, status.phrase, headers, body)
