"""PLY: a text header that declares elements, then rows as text or bytes."""

from __future__ import annotations

from dataclasses import dataclass, field

from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits

SIZES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1,
    "short": 2, "ushort": 2, "int16": 2, "uint16": 2, "float16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4,
    "double": 8, "float64": 8, "int64": 8, "uint64": 8,
}  # fmt: skip
MAX_HEADER = 1 << 16
_ENCODINGS = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}
INDEX_NAMES = ("vertex_indices", "vertex_index")


@dataclass
class Element:
    """An element of the header: its count, the bytes of its scalar properties, and its lists."""

    name: str
    count: int
    scalar_bytes: int = 0
    lists: dict[str, tuple[str, str]] = field(default_factory=dict)
    names: set[str] = field(default_factory=set)

    def least_bytes(self) -> int:
        """Bytes a row takes at least: a face has three indices or more."""
        total = self.scalar_bytes
        for name, (count, item) in self.lists.items():
            total += SIZES[count] + (3 * SIZES[item] if self.name == "face" and name in INDEX_NAMES else 0)
        return total


@dataclass(frozen=True)
class Header:
    """A read header; `body` is the offset of the first row."""

    encoding: str
    elements: dict[str, Element]
    body: int


def looks_like(data: bytes) -> bool:
    """Whether these are PLY bytes."""
    return data[:3].lower() == b"ply" and data[3:4] in (b"\n", b"\r", b" ")


def check(data: bytes, limits: LoadLimits) -> None:
    """Refuse a broken header, counts the file has no room for, and a file without faces."""
    header = read_header(data)
    vertex, rows = header.elements.get("vertex"), sum(e.count for e in header.elements.values())
    if vertex is None or not {"x", "y", "z"} <= vertex.names:
        raise rejected("not-a-mesh", "The PLY file has no vertices with x, y and z.")
    left = len(data) - header.body
    needed = 2 * rows - 1 if header.encoding == "ascii" else sum(e.count * e.least_bytes() for e in header.elements.values())
    if needed > left:
        raise rejected(
            "truncated",
            f"The PLY header declares {rows} rows, which take at least {needed} bytes, but {left} bytes follow it.",
            expected_bytes=needed,
            bytes=left,
        )
    if header.encoding == "ascii":
        lines = sum(1 for line in data[header.body :].splitlines() if line.strip())
        if lines < rows:
            raise rejected(
                "truncated", f"The PLY header declares {rows} rows, but {lines} lines follow it.", expected_rows=rows, rows=lines
            )
    faces = sum(header.elements[name].count for name in ("face", "tristrips") if name in header.elements)
    if not faces or not vertex.count:
        raise rejected("no-faces", f"The PLY file has {vertex.count} vertices and no faces.", vertices=vertex.count)


def read_header(data: bytes) -> Header:
    """Read the header; MeshRejectedError names the line that is wrong."""
    end = data.find(b"end_header", 0, MAX_HEADER)
    body = data.find(b"\n", end) + 1
    if end < 0 or not body:
        raise rejected("truncated" if len(data) < MAX_HEADER else "not-a-mesh", "The PLY header does not end.")
    encoding = ""
    elements: dict[str, Element] = {}
    for number, line in enumerate(data[:end].decode("latin-1").splitlines(), start=1):
        words = line.split()
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        try:
            if words[0] == "format":
                encoding = _ENCODINGS[words[1]]
            else:
                _declaration(elements, words)
        except (KeyError, IndexError, ValueError):
            raise rejected("not-a-mesh", f"Line {number} of the PLY header is wrong.", line=number) from None
    if not encoding:
        raise rejected("not-a-mesh", "The PLY header names no format.")
    return Header(encoding, elements, body)


def _declaration(elements: dict[str, Element], words: list[str]) -> None:
    """Take an `element` or `property` line; KeyError, IndexError or ValueError when it is neither."""
    if words[0] == "element":
        if words[1] in elements:
            raise ValueError(words[1])
        elements[words[1]] = Element(words[1], _count(words[2]))
    elif words[0] == "property" and elements:
        _property(elements[next(reversed(elements))], words)
    else:
        raise KeyError(words[0])


def _count(word: str) -> int:
    if not (word.isascii() and word.isdigit()):
        raise ValueError(word)
    return int(word[:18])


def _property(element: Element, words: list[str]) -> None:
    if words[1] == "list":
        element.lists[words[4]] = (words[2], words[3])
        _ = SIZES[words[2]], SIZES[words[3]]
    else:
        element.scalar_bytes += SIZES[words[1]]
        element.names.add(words[2])
