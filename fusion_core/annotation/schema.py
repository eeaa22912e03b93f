"""The journal's tables, in SQLite and in PostgreSQL.

The state is not stored: a sample's label is what its newest change left. ``change_state`` has all
that this takes, in order. Actions, changes, and the layers and captures that they name are never
altered or deleted: the database itself refuses it.
"""

from collections.abc import Iterator

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    Connection,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    SmallInteger,
    Table,
    Text,
    UniqueConstraint,
)

from fusion_core.model.labels import NO_LABEL, Label

SCHEMA_VERSION = 1

metadata = MetaData()

# SQLite numbers rows by a column that is called INTEGER, which has 64 bits there.
_Id = BigInteger().with_variant(Integer, "sqlite")
# In the order of code points, as Python sorts, whatever the database's language.
_Text = Text().with_variant(Text(collation="C"), "postgresql")

store = Table(
    "store",
    metadata,
    Column("id", Integer, CheckConstraint("id = 1"), primary_key=True),
    Column("schema_version", Integer, nullable=False),
    Column("recording_name", _Text, nullable=False),
    Column("recording_sha256", _Text, nullable=False),
    Column("created_utc", _Text, nullable=False),
    Column("tool_version", _Text, nullable=False),
)

# A cache. Several people's copies of one recording differ in their times.
input_file = Table(
    "input_file",
    metadata,
    Column("name", _Text, primary_key=True),
    Column("size", BigInteger, primary_key=True),
    Column("mtime_ns", BigInteger, primary_key=True),
    Column("sha256", _Text, nullable=False),
)

layer = Table(
    "layer",
    metadata,
    Column("id", _Id, primary_key=True),
    Column("name", _Text, nullable=False, unique=True),
)

capture = Table(
    "capture",
    metadata,
    Column("id", _Id, primary_key=True),
    Column("sensor", _Text, CheckConstraint("sensor IN ('lidar', 'depth')"), nullable=False),
    Column("topic", _Text, nullable=False),
    Column("stamp_ns", BigInteger, nullable=False),
    Column("index", Integer, nullable=False),
    Column("rows", Integer, nullable=False),
    Column("columns", Integer, nullable=False),
    UniqueConstraint("sensor", "topic", "stamp_ns", "index"),
)

# ``below_id``: see undo_stacks.py.
action = Table(
    "action",
    metadata,
    Column("id", _Id, primary_key=True, autoincrement=False),
    Column("layer_id", _Id, ForeignKey("layer.id"), nullable=False),
    Column("kind", _Text, CheckConstraint("kind IN ('do', 'undo', 'redo')"), nullable=False),
    Column("target_id", _Id, ForeignKey("action.id")),
    Column("below_id", _Id, ForeignKey("action.id")),
    Column("time_utc", _Text, nullable=False),
    Column("annotator", _Text, nullable=False),
    Column(
        "source",
        _Text,
        CheckConstraint("source IN ('human', 'automatic', 'imported')"),
        nullable=False,
    ),
    Column("settings_sha256", _Text, nullable=False),
    Column("version", _Text, nullable=False),
    Column("comment", _Text, nullable=False),
    Index("action_of_annotator", "layer_id", "annotator", "id"),
)


def _label_column(name: str) -> Column[int]:
    codes = f"{name} BETWEEN {NO_LABEL} AND {max(Label)}"
    return Column(name, SmallInteger, CheckConstraint(codes), nullable=False)


change = Table(
    "change",
    metadata,
    Column("action_id", _Id, ForeignKey("action.id"), primary_key=True, autoincrement=False),
    Column("layer_id", _Id, ForeignKey("layer.id"), nullable=False),
    Column("capture_id", _Id, ForeignKey("capture.id"), primary_key=True, autoincrement=False),
    Column("row", Integer, primary_key=True, autoincrement=False),
    Column("column", Integer, primary_key=True, autoincrement=False),
    _label_column("before"),
    _label_column("after"),
    Index("change_state", "layer_id", "capture_id", "row", "column", "action_id", "after"),
    sqlite_with_rowid=False,
)

_APPEND_ONLY = (layer, capture, action, change)
_REFUSAL = "the journal is append-only"


def make_tables(connection: Connection) -> None:
    """Make all tables in an empty database, and have it refuse what is not an insertion."""
    metadata.create_all(connection)
    sqlite = connection.dialect.name == "sqlite"
    for statement in _sqlite_guards() if sqlite else _postgresql_guards():
        connection.exec_driver_sql(statement)


def _postgresql_guards() -> Iterator[str]:
    yield f"""
        CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS
        'BEGIN RAISE EXCEPTION ''{_REFUSAL}''; END'
    """
    for table in _APPEND_ONLY:
        yield f"""
            CREATE TRIGGER {table.name}_is_append_only
            BEFORE UPDATE OR DELETE OR TRUNCATE ON {table.name}
            FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()
        """


def _sqlite_guards() -> Iterator[str]:
    guards = [(table.name, verb, "") for table in _APPEND_ONLY for verb in ("UPDATE", "DELETE")]
    # INSERT OR REPLACE deletes, and triggers of deletion do not see it.
    guards += [
        (name, "INSERT", f"WHEN NEW.id <> (SELECT ifnull(max(id), 0) + 1 FROM {name})")
        for name in (layer.name, capture.name, action.name)
    ]
    guards.append(("change", "INSERT", "WHEN NEW.action_id <> (SELECT max(id) FROM action)"))
    for table, verb, condition in guards:
        yield f"""
            CREATE TRIGGER {table}_{verb.lower()} BEFORE {verb} ON "{table}" {condition}
            BEGIN SELECT RAISE(ABORT, '{_REFUSAL}'); END
        """
