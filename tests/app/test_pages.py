"""The pages that the server makes itself: what a browser gets at its start."""

import gzip
import re
from pathlib import Path

import pytest
import viser
from websockets.datastructures import Headers
from websockets.http11 import Request

from scanloom.resources import static_path
from scanloom.server.pages import own_page

VISERS = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text("utf-8")


def start_page(encodings: str) -> tuple[str, Headers]:
    """The start page for a browser that reads these encodings, and its headers."""
    response = own_page(Request("/", Headers({"Accept-Encoding": encodings})))
    assert response is not None
    assert response.status_code == 200
    headers = response.headers
    body = bytes(response.body)
    assert headers["Content-Length"] == str(len(body))
    return (gzip.decompress(body) if "Content-Encoding" in headers else body).decode(), headers


def test_the_start_page_is_visers_with_our_name_icon_and_script() -> None:
    page, headers = start_page("")
    assert "Content-Encoding" not in headers
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    # The first title counts, and the last icon.
    assert re.findall("<title>(.*?)</title>", page)[0] == "ScanLoom"
    assert re.findall(r'<link\s+rel="icon"[^>]*>', page)[-1].count("data:image/svg+xml;base64,")
    scripts = re.findall("<script[^>]*>(.*?)</script>", page, re.DOTALL)
    assert scripts[0] == static_path("start.js").read_text("utf-8")
    assert scripts[1:] == re.findall("<script[^>]*>(.*?)</script>", VISERS, re.DOTALL)
    assert '<div id="root">' in page


@pytest.mark.parametrize("encodings", ["gzip", "gzip, deflate, br, zstd"])
def test_the_start_page_is_compressed_where_the_browser_reads_it(encodings: str) -> None:
    page, headers = start_page(encodings)
    assert headers["Content-Encoding"] == "gzip"
    assert page == start_page("identity")[0]


@pytest.mark.parametrize("path", ["/missing", "//", "/go/", "/index.html", ""])
def test_other_paths_are_left_to_viser(path: str) -> None:
    assert own_page(Request(path, Headers())) is None


def test_a_query_changes_no_page() -> None:
    response = own_page(Request("/?", Headers()))
    assert response is not None
    assert response.status_code == 200
