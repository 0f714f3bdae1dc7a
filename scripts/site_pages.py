"""What the documentation site makes while it is built: tutorials that are run, the commands' help, the files' schemas.

A tutorial is a Python file whose cells begin with ``# %%`` (``# %% [markdown]`` for text), as editors and Jupyter
understand it. Its code is run; what it prints, and the value or picture of a cell's last line, stand below the cell.
Equations are LaTeX, written as GitHub shows it, too: a fence ``math``, or $`...`$ within a line. They become MathML,
which browsers draw by themselves: nothing is fetched.
"""

from __future__ import annotations

import ast
import io
import os
import re
import tempfile
from argparse import ArgumentParser
from collections.abc import Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / "docs" / "tutorials"
LONGEST_OUTPUT = 6000
CALLED = {
    "phantom_check": "phantom-check.json",
    "room": "room.toml",
    "hand_eye": "hand-eye.json",
    "robot_points": "robot export --to json",
}
"""What the files are called, or made by, that are not called NAME.json."""
OUTPUT = "``` { .text .no-copy }"
"""Opens what a cell printed; a button to copy it would cover it."""
EQUATION = re.compile(r"^```math\n(?P<block>.*?)^```$|\$`(?P<inline>[^`]+)`\$", re.MULTILINE | re.DOTALL)


@dataclass
class Page:
    """A rendered tutorial: Markdown, and the pictures (name -> PNG) that it shows."""

    text: str = ""
    pictures: dict[str, bytes] = field(default_factory=dict)


def cells(source: str) -> Iterator[tuple[str, str]]:
    """Yield the kind (markdown or code) and the content of each cell."""
    for part in source.split("# %%")[1:]:
        head, _, body = part.partition("\n")
        if "markdown" in head:
            yield (
                "markdown",
                "\n".join(line.removeprefix("#").removeprefix(" ") for line in body.strip().splitlines()),
            )
        else:
            yield "code", body.strip()


def rendered(tutorial: Path) -> Page:
    """Run a tutorial where ``data`` lies beside it, and return its page; what it raises is raised."""
    page, names = Page(), {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        Path("data").symlink_to(ROOT / "data")
        for kind, content in cells(tutorial.read_text(encoding="utf-8")):
            page.text += f"{content}\n\n" if kind == "markdown" else f"```python\n{content}\n```\n\n"
            if kind == "code":
                page.text += _output(content, names, page, tutorial.stem)
    return page


def _output(code: str, names: dict[str, Any], page: Page, stem: str) -> str:
    """Run one cell; return what it showed, as Markdown."""
    tree = ast.parse(code)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    value: Any = None
    with redirect_stdout(printed), redirect_stderr(printed):
        exec(compile(tree, stem, "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), stem, "eval"), names)
    text = ""
    if hasattr(value, "_repr_png_"):
        name = f"{stem}-{len(page.pictures) + 1}.png"
        page.pictures[name] = value._repr_png_()
        text = f"![what the cell shows]({name})\n\n"
    elif value is not None:
        printed.write(f"{value!r}\n" if not hasattr(value, "to_string") else f"{value.round(3).to_string()}\n")
    shown = printed.getvalue().rstrip()[:LONGEST_OUTPUT]
    return (f"{OUTPUT}\n{shown}\n```\n\n" if shown else "") + text


def commands_page() -> str:
    """Return the help of every verb and of its actions."""
    from ronnaplan.cli import command_parser

    os.environ["COLUMNS"] = "100"
    described = "\n".join(_described(command_parser(), "##"))
    return f"# Commands\n\nAs `ronnaplan VERB --help` and `ronnaplan VERB ACTION --help` say it.\n{described}"


def _described(parser: ArgumentParser, heading: str) -> Iterator[str]:
    """Yield the help of each verb of a parser, and below it of each of the verb's own."""
    for verbs in (one.choices for one in parser._actions if isinstance(one.choices, dict)):
        for verb in verbs.values():
            yield f"{heading} {verb.prog}\n\n```text\n{verb.format_help().rstrip()}\n```\n"
            yield from _described(verb, f"{heading}#")


def schemas_page() -> str:
    """Return where each file's JSON Schema is, and what its fields are."""
    from ronnaplan.documents.schemas import DOCUMENTS, schema

    text = (
        "# Files\n\nEvery file is UTF-8 JSON (room.toml: TOML), read strictly: no unknown field, no number as text. "
        "`ronnaplan schema NAME` prints the JSON Schema (draft 2020-12) of a file: what each field may be. The "
        "package holds it, too: `ronnaplan/documents/schema/NAME.schema.json`. What joins fields "
        "(a covariance is positive definite, a residual fits its transform) is checked when the file is read. "
        "Lengths are mm, coordinates DICOM LPS; of the robot's files those of the frames that they name "
        "([robot](../robot.md#what-each-document-holds)).\n"
    )
    for name, model in DOCUMENTS.items():
        described = schema(name)
        text += f"\n## {CALLED.get(name, f'{name}.json')}\n\n{(model.__doc__ or '').strip()}\n\n"
        text += "| field | type | needed |\n|---|---|---|\n"
        for each, kind in described["properties"].items():
            needed = "yes" if each in described.get("required", ()) else ""
            text += f"| `{each}` | {_kind(kind)} | {needed} |\n"
        for part, content in described.get("$defs", {}).items():
            fields = ", ".join(f"`{one}`" for one in content.get("properties", {}))
            first = content.get("description", "").partition("\n")[0]
            text += f"\n*{part}*: {first} Fields: {fields}.\n"
    return text


def _kind(described: dict[str, Any]) -> str:
    if "$ref" in described:
        return str(described["$ref"].rsplit("/", 1)[1])
    if "anyOf" in described:
        return " or ".join(_kind(one) for one in described["anyOf"])
    if "const" in described:
        return f"`{described['const']!r}`"
    if described.get("type") == "array":
        return f"list of {_kind(described.get('items', {}))}" if "items" in described else "list of numbers"
    return str(described.get("type", "any"))


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Turn the equations of a page into MathML (called by mkdocs)."""
    return EQUATION.sub(_equation, markdown)


def _equation(found: re.Match[str]) -> str:
    """Return one equation as MathML on one line; what LaTeX does not know is raised."""
    from latex2mathml.converter import convert

    if found["block"]:
        return f'<div class="equation">{convert(" ".join(found["block"].split()), display="block")}</div>'
    return f"<span>{convert(found['inline'])}</span>"  # else a line that begins with it would be a block


def changelog_page() -> str:
    """Return the changelog, whose links lead from the source's folder, with links from the pages'."""
    return (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").replace("](docs/", "](")


def on_files(files: Any, config: Any) -> Any:
    """Add what is made to the site's files (called by mkdocs)."""
    from mkdocs.structure.files import File

    made: dict[str, str | bytes] = {
        "reference/commands.md": commands_page(),
        "reference/files.md": schemas_page(),
        "changelog.md": changelog_page(),
    }
    for tutorial in sorted(TUTORIALS.glob("*.py")):
        page = rendered(tutorial)
        made[f"tutorials/{tutorial.stem}.md"] = page.text
        made |= {f"tutorials/{name}": picture for name, picture in page.pictures.items()}
    for place, content in made.items():
        files.append(File.generated(config, place, content=content))
    return files
