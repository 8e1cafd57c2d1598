"""3MF: a ZIP archive with a model in XML. Sizes, ratio and declarations are checked before anything is unpacked whole."""

from __future__ import annotations

import io
import re
import zipfile
import zlib

from worker.loading.faults import rejected
from worker.loading.limits import MIB, LoadLimits

MAX_MEMBERS = 4096
RATIO_FREE_BYTES = 16 * MIB
_BLOCK = 1 << 20
_TRIANGLE = re.compile(rb"<(?:\w+:)?triangle\s")
_FORBIDDEN = re.compile(rb"<!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)


def looks_like(data: bytes) -> bool:
    """Whether these are the bytes of a ZIP archive with a 3D part."""
    return data[:4] == b"PK\x03\x04"


def check(data: bytes, limits: LoadLimits) -> None:
    """Refuse what is no archive, unpacks to too much, has no model, or declares XML entities."""
    if not looks_like(data):
        raise rejected("not-a-mesh", "The file is named 3MF, but is not a ZIP archive.")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            _check_sizes(members, len(data), limits)
            models = [m for m in members if m.filename.lower().endswith(".model")]
            if not any("3d/3dmodel.model" in m.filename.lower() for m in models):
                raise rejected("not-a-mesh", "The archive has no 3D model part, so it is not a 3MF file.")
            with_triangles = [member for member in models if _check_xml(archive, member)]
            if not with_triangles:
                raise rejected("no-faces", "The 3MF file has no triangles.")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError, ValueError, zlib.error):
        raise rejected("truncated", "The 3MF archive is broken or cut off: it cannot be unpacked.") from None


def _check_sizes(members: list[zipfile.ZipInfo], packed: int, limits: LoadLimits) -> None:
    if len(members) > MAX_MEMBERS:
        raise rejected("decompression-limit", f"The 3MF archive has {len(members)} members; {MAX_MEMBERS} are allowed.")
    if any(m.flag_bits & 1 for m in members):
        raise rejected("unsupported-feature", "The 3MF archive is encrypted.")
    total = sum(m.file_size for m in members)
    if total > limits.unpacked_mib * MIB:
        raise rejected(
            "decompression-limit",
            f"The 3MF archive would unpack to {total // MIB} MiB; {limits.unpacked_mib} MiB are allowed.",
            bytes=total,
        )
    if total > RATIO_FREE_BYTES and total > limits.unpacked_ratio * packed:
        raise rejected(
            "decompression-limit",
            f"The 3MF archive would unpack to {total // packed} times its size; {limits.unpacked_ratio} times are allowed.",
            bytes=total,
        )


def _check_xml(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bool:
    """No document type or entity anywhere; zero bytes are dropped so that UTF-16 hides nothing. Whether it has triangles."""
    tail, found = b"", False
    with archive.open(member) as stream:
        while block := stream.read(_BLOCK):
            window = tail + block.replace(b"\0", b"")
            if _FORBIDDEN.search(window):
                raise rejected("forbidden-xml", "The model of the 3MF file declares a document type or entities, which are not allowed.")
            found = found or _TRIANGLE.search(window) is not None
            tail = window[-64:]
    return found
