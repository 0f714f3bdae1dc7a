"""The documentation's links lead somewhere, its reference has the whole face, its tutorials run."""

from __future__ import annotations

import importlib.util
import re
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import ronnaplan
from ronnaplan.text import NOTICE

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PACKAGE = ROOT / "ronnaplan"
MADE = {
    "changelog.md",
    "reference/commands.md",
    "reference/files.md",
    *(f"tutorials/{one.stem}.md" for one in DOCS.glob("tutorials/*.py")),
}
"""Pages that are made when the site is built."""
QUICK = ("which_layout", "tracker_to_robot")
"""Tutorials that take less than a second; `scripts/site` runs all of them."""


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("site_pages", ROOT / "scripts" / "site_pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["site_pages"] = module
    spec.loader.exec_module(module)
    return module


def anchors(page: Path) -> set[str]:
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-") for head in heads}


def test_every_internal_link_leads_to_a_page_and_its_heading() -> None:
    pages = [*DOCS.rglob("*.md"), *DOCS.rglob("*.py"), *ROOT.glob("*.md")]
    made = {DOCS / one for one in MADE}
    assert len(pages) > 25
    for page in pages:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            path, _, anchor = target.partition("#")
            place = (page.parent / path).resolve() if path else page
            if "//" in target or place in made:
                continue
            assert place.exists(), (page, target)
            assert not anchor or anchor in anchors(place), (page, target)


def test_links_of_the_changelog_lead_to_pages(maker: ModuleType) -> None:
    targets = re.findall(r"\]\(([^)\s#]+)", maker.changelog_page())
    assert "tables.md" in targets
    assert all((DOCS / target).is_file() for target in targets if not target.startswith("https:"))


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    listed = set(re.findall(r": (\S+\.md)$", navigation, re.M))
    there = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")} | MADE
    assert listed == there


def test_the_reference_has_all_that_the_package_offers() -> None:
    described = set(
        re.findall(r"^::: (\S+)$", (DOCS / "reference" / "python.md").read_text(encoding="utf-8"), re.M)
    )
    rooms = [
        ronnaplan,
        *(import_module(f"ronnaplan.{stub.parent.name}") for stub in PACKAGE.glob("*/__init__.pyi")),
    ]
    assert len(rooms) > 7
    for room in rooms:
        for name in room.__all__:
            where = getattr(getattr(room, name), "__module__", None)  # two rooms have limits of their own
            assert any(
                one.endswith(f".{name}") and (where is None or one == f"{where}.{name}") for one in described
            ), (
                room.__name__,
                name,
            )


def test_each_name_of_the_reference_is_imported_from_where_its_heading_says() -> None:
    package, seen = "", 0
    for line in (DOCS / "reference" / "python.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            package = line.removeprefix("## ")
        elif line.startswith("::: ") and line != f"::: {package}":
            name = line.rpartition(".")[2]
            assert hasattr(import_module(package), name), (package, name)
            seen += 1
    assert seen > 60


def test_every_flag_is_told_on_its_page() -> None:
    from ronnaplan.ct import VolumeFlag
    from ronnaplan.localization import FiducialFlag
    from ronnaplan.registration import RegistrationFlag

    small = [flag.name.lower() for flag in FiducialFlag]
    told = {
        "localization": small,
        "scanners": small,
        "reading": [flag.name for flag in VolumeFlag],
        "registration": [flag.name for flag in RegistrationFlag],
    }
    for page, names in told.items():
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        assert [name for name in names if f"`{name}`" not in text] == [], page


def test_each_page_says_at_its_foot_what_this_is_not() -> None:
    assert f"\ncopyright: {NOTICE} " in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")


def test_the_search_needs_no_host() -> None:
    """The plugin "offline" names one for what runs the search in files, unless the site has it."""
    (script,) = re.findall(r"polyfills: \[(.*)\]", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert "iframe-worker" in script
    assert "window.Worker=" in (DOCS / script).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", QUICK)
def test_a_tutorial_runs(maker: ModuleType, name: str) -> None:
    page = maker.rendered(DOCS / "tutorials" / f"{name}.py")
    assert page.text.startswith("# ")
    assert page.text.count(maker.OUTPUT) >= 2


def test_every_equation_becomes_mathml_and_none_is_left_as_latex(maker: ModuleType) -> None:
    rooms = (
        "reading",
        "localization",
        "correspondence",
        "registration",
        "tracking",
        "planning",
        "robot",
        "robot_method",
        "phantoms",
    )
    for room in rooms:
        text = (DOCS / f"{room}.md").read_text(encoding="utf-8")
        page = maker.on_page_markdown(text)
        assert page.count('<div class="equation">') == text.count("```math\n") > 0
        assert "$`" not in page
        for equation in re.findall(r"<math .*?</math>", page):
            assert "\\" not in equation, room  # a command that the converter does not know stays as it is


def test_a_cell_that_fails_fails_the_page_and_pictures_are_kept(maker: ModuleType, tmp_path: Path) -> None:
    shown = (
        "# %% [markdown]\n# # Title\n# %%\nclass P:\n    def _repr_png_(self): return b'png'\nprint('said')\nP()\n"
    )
    (tmp_path / "good.py").write_text(shown)
    page = maker.rendered(tmp_path / "good.py")
    assert page.pictures == {"good-1.png": b"png"}
    assert "said" in page.text
    assert "(good-1.png)" in page.text
    (tmp_path / "bad.py").write_text("# %%\n1 / 0\n")
    with pytest.raises(ZeroDivisionError):
        maker.rendered(tmp_path / "bad.py")


def test_commands_and_files_are_described(maker: ModuleType) -> None:
    from ronnaplan.cli import VERBS

    commands = maker.commands_page()
    assert all(f"## ronnaplan {verb}\n" in commands for verb in VERBS)
    for action, option in (
        ("plan markers", "--lowest"),
        ("robot chain", "--hand-eye"),
        ("study chain", "--output"),
    ):
        assert option in commands.partition(f"### ronnaplan {action}\n")[2].partition("\n#")[0]
    files = maker.schemas_page()
    assert all(f"## {name}.json" in files for name in ("fiducials", "registration", "plan", "limits", "template"))
    assert all(f"\n## {name}\n" in files for name in ("room.toml", "phantom-check.json"))
    assert "`covariance`" in files
