"""Label stores in SQLite and in PostgreSQL, whose server is run by the tests alone."""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import psycopg
import pytest

from tests.annotation.postgresql_server import Server, find_programs, may_run

NewAddress = Callable[[], str]


@pytest.fixture(scope="session")
def postgresql() -> Iterator[Server]:
    """A running server; tests are skipped where Debian's package is not installed."""
    programs = find_programs()
    if programs is None:
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    if not may_run():
        pytest.skip("PostgreSQL does not run as root, and there is no user postgres")
    # Not below pytest's own folders, which another user may not enter.
    folder = Path(tempfile.mkdtemp(prefix="scanloom-postgresql-"))
    try:
        server = Server(programs, folder)
        server.start()
        try:
            yield server
        finally:
            server.stop("immediate")
    finally:
        shutil.rmtree(folder)


@pytest.fixture(scope="session")
def new_database(postgresql: Server) -> NewAddress:
    """Makes empty schemas of one database, which is much faster than databases."""
    numbers = count()

    def make() -> str:
        name = f"labels_{next(numbers)}"
        with psycopg.connect(postgresql.address("postgres")) as connection:
            connection.execute(f"CREATE SCHEMA {name}".encode())
        return f"{postgresql.address('postgres')}?options=-csearch_path%3D{name}"

    return make


@pytest.fixture(params=["sqlite", "postgresql"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Where a label store can be made, in each database in turn."""
    if request.param == "sqlite":
        return str(tmp_path / "room.labels.sqlite")
    new_database: NewAddress = request.getfixturevalue("new_database")
    return new_database()
