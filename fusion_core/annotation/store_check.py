"""Whether a database holds a label store of this version, and of which recording."""

from datetime import UTC, datetime

from sqlalchemy import Connection, insert, inspect, select
from sqlalchemy.exc import DBAPIError

from fusion_core.annotation import schema
from fusion_core.annotation.database_errors import damaged
from fusion_core.annotation.identity import RecordingIdentity
from fusion_core.model.errors import LabelStoreError
from fusion_core.model.project import project_version


def make_store(connection: Connection, recording: RecordingIdentity) -> None:
    """Make a store without labels in an empty database."""
    schema.make_tables(connection)
    connection.execute(
        insert(schema.store).values(
            id=1,
            schema_version=schema.SCHEMA_VERSION,
            recording_name=recording.name,
            recording_sha256=recording.sha256,
            created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
            tool_version=project_version(),
        )
    )


def require_sound(connection: Connection, place: str) -> None:
    """Raise LabelStoreError where the store has a newer schema, lacks a table or is damaged."""
    store = schema.store
    try:
        version = connection.execute(select(store.c.schema_version)).scalar_one_or_none()
    except DBAPIError as error:
        if inspect(connection).has_table(store.name):
            raise
        raise damaged(place, f"it has no table {store.name}") from error
    if version is None:
        raise damaged(place, "it does not say of which recording it is")
    if version > schema.SCHEMA_VERSION:
        raise LabelStoreError(
            f"was written by a newer ScanLoom: schema {version}, this one knows "
            f"{schema.SCHEMA_VERSION}.",
            file=place,
            advice="Update ScanLoom; the store was left as it is.",
        )
    found = inspect(connection).get_multi_columns()
    columns = {
        name: {column["name"] for column in found_columns}
        for (_, name), found_columns in found.items()
    }
    for table in schema.metadata.sorted_tables:
        if columns.get(table.name) != set(table.columns.keys()):
            raise damaged(place, f"its table {table.name} is not as ScanLoom makes it")
    if connection.dialect.name == "sqlite":
        faults = connection.exec_driver_sql("PRAGMA quick_check(1)").scalars().all()
        if faults != ["ok"]:
            raise damaged(place, str(faults[0]))


def require_recording(connection: Connection, place: str, recording: RecordingIdentity) -> None:
    """Raise LabelStoreError where the labels are those of another recording."""
    store = schema.store
    own = connection.execute(select(store.c.recording_name, store.c.recording_sha256)).one()
    if own.recording_sha256 != recording.sha256:
        raise LabelStoreError(
            f"holds the labels of {own.recording_name} with SHA-256 {own.recording_sha256[:12]}…, "
            f"not of {recording.name} with {recording.sha256[:12]}….",
            file=place,
            advice="Open the recording as it was labelled, or name another store by --labels.",
        )
