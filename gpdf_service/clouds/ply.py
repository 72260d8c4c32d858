"""Whether a .ply holds all that its head promises: where one ends early, Open3D gives whatever lay in memory."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

from gpdf_service.errors import CloudError

BYTES = {
    **dict.fromkeys((b"char", b"uchar", b"int8", b"uint8"), 1),
    **dict.fromkeys((b"short", b"ushort", b"int16", b"uint16"), 2),
    **dict.fromkeys((b"int", b"uint", b"int32", b"uint32", b"float", b"float32"), 4),
    **dict.fromkeys((b"double", b"float64"), 8),
}
"""Of a property in a binary file; a list is as long as it says itself."""
CHUNK_BYTES = 1 << 20


def check_whole(path: Path) -> None:
    """Look for the last vertex.

    Raises:
        CloudError: the file ends before it.
    """
    with path.open("rb") as file:
        head = [line.split() for line in takewhile(lambda line: line.strip() != b"end_header", file)]
        written = [b"format", b"ascii"] in [words[:2] for words in head]
        chunks = iter(lambda: file.read(CHUNK_BYTES), b"")
        left = sum(chunk.count(b"\n") if written else len(chunk) for chunk in chunks)
    for count, kinds, name in _elements(head):
        if not written and not set(kinds) <= BYTES.keys():
            return
        each = 1 if written else sum(BYTES[kind] for kind in kinds)
        if left < count * each - written:  # the last line may have no end
            found = f"it ends after {max(left, 0) // each} of {count} rows of its element {name!r}"
            raise CloudError(f"cloud {path}", found, "Was it copied to its end?")
        if name == "vertex":
            return
        left -= count * each


def _elements(head: list[list[bytes]]) -> list[tuple[int, list[bytes], str]]:
    """How many rows each element has, the kinds of its properties, and its name, as the head says."""
    found: list[tuple[int, list[bytes], str]] = []
    for words in head:
        if words[:1] == [b"element"]:
            found.append((int(words[2]), [], words[1].decode()))
        elif words[:1] == [b"property"]:
            found[-1][1].append(words[1])
    return found
