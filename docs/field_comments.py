"""Adds the comments beside the fields of a class to its page in the reference.

The packages document the shape, unit and frame of a field by a comment: `points: Array  # (m, 2) [m] in R`.
mkdocstrings reads docstrings only, so this extension of Griffe writes the comments into the docstring of the class.
"""

import ast
import io
import tokenize
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import griffe

NOT_FOR_READERS = ("noqa", "type:", "fmt:")


class Comments(NamedTuple):
    """The comments of a file by their line number."""

    beside: dict[int, str]  # after code
    alone: dict[int, str]  # on a line of their own


class FieldComments(griffe.Extension):
    """Adds a section `Attributes` with the comments of fields to the docstring of a class."""

    def on_class_members(self, *, node: ast.AST | griffe.ObjectNode, cls: griffe.Class, **_: Any) -> None:
        """Add the section if any field has a comment and no docstring of its own."""
        if not isinstance(cls.filepath, Path):
            return
        fields = [a for a in cls.members.values() if isinstance(a, griffe.Attribute) and a.docstring is None]
        found = {a.name: comment_of(a, comments(cls.filepath)) for a in fields if a.annotation is not None}
        lines = [f"    {name}: {text}" for name, text in found.items() if text and not name.startswith("_")]
        if lines:
            written = cls.docstring.value if cls.docstring else ""
            text = "\n".join([written, "", "Attributes:", *lines])
            cls.docstring = griffe.Docstring(text, parent=cls, parser="google", parser_options={"warnings": False})


def comment_of(field: griffe.Attribute, of_file: Comments) -> str:
    """The comment beside a field; otherwise those on the lines directly below it, or the one directly above."""
    first, last = field.lineno or 0, field.endlineno or 0
    if last in of_file.beside:
        return of_file.beside[last]
    below, line = [], last + 1
    while line in of_file.alone:
        below.append(of_file.alone[line])
        line += 1
    return " ".join(below) or of_file.alone.get(first - 1, "")


@lru_cache
def comments(path: Path) -> Comments:
    """All comments of a file that are meant for readers."""
    source = path.read_text(encoding="utf-8")
    lines, found = source.splitlines(), Comments({}, {})
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        text = token.string.lstrip("# ").strip()
        if token.type == tokenize.COMMENT and not text.startswith(NOT_FOR_READERS):
            has_code = lines[token.start[0] - 1][: token.start[1]].strip()
            (found.beside if has_code else found.alone)[token.start[0]] = text
    return found
