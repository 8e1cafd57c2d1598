"""Shader programs by name: `shaders/<name>.vert.glsl`, `.geom.glsl` and `.frag.glsl`, in variants by preprocessor definitions."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import resources
from typing import Any

import moderngl

VERSION = "#version 330 core\n"
INCLUDE = "//! include "


def shader_source(file: str, definitions: Iterable[str] = ()) -> str:
    """The text of a shader with its version line, definitions and included files (`//! include <file>`)."""
    lines = resources.files("service.render").joinpath("shaders", file).read_text("utf-8").splitlines()
    body = [shader_body(line.removeprefix(INCLUDE)) if line.startswith(INCLUDE) else line for line in lines]
    return VERSION + "".join(f"#define {name}\n" for name in sorted(definitions)) + "\n".join(body) + "\n"


def shader_body(file: str) -> str:
    """The text of an included file."""
    return resources.files("service.render").joinpath("shaders", file).read_text("utf-8")


class Programs:
    """Compiled programs, kept for good: their number is bounded by the variants there are."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._kept: dict[tuple[str, str, str, frozenset[str]], moderngl.Program] = {}
        self._set: dict[tuple[moderngl.Program, str], Any] = {}

    def get(self, vertex: str, fragment: str, definitions: frozenset[str] = frozenset(), *, geometry: str = "") -> moderngl.Program:
        """The program of `vertex`.vert.glsl and `fragment`.frag.glsl, with `geometry`.geom.glsl between them where one is named."""
        key = (vertex, geometry, fragment, definitions)
        if key not in self._kept:
            self._kept[key] = self._ctx.program(
                vertex_shader=shader_source(f"{vertex}.vert.glsl", definitions),
                geometry_shader=shader_source(f"{geometry}.geom.glsl", definitions) if geometry else None,
                fragment_shader=shader_source(f"{fragment}.frag.glsl", definitions),
            )
        return self._kept[key]

    def set(self, program: moderngl.Program, **values: Any) -> None:
        """Set uniforms by name: numbers, tuples of numbers, or matrices as bytes. Those a variant does not use are passed over."""
        for name, value in values.items():
            if self._set.get((program, name)) == value:
                continue
            self._set[program, name] = value
            member = program.get(name, None)
            if isinstance(member, moderngl.Uniform):
                if isinstance(value, bytes):
                    member.write(value)
                else:
                    member.value = value

    def release(self) -> None:
        """Delete them all."""
        for program in self._kept.values():
            program.release()
        self._kept.clear()
