"""How a label store is told from other databases of SQLite: by the application's number in its
header (https://sqlite.org/fileformat2.html, §1.3)."""

SQLITE_MAGIC = b"SQLite format 3\0"
APPLICATION_ID = 0x5363_4C6C
"""ScLl."""

_PLACE = slice(68, 72)


def is_label_store(head: bytes) -> bool:
    """Of a file's first bytes."""
    number = int.from_bytes(head[_PLACE], "big")
    return head.startswith(SQLITE_MAGIC) and number == APPLICATION_ID
