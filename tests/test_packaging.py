"""What goes with a release agrees with the package: versions, the bill of materials, continuous integration."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from ronnaplan import __version__

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_one_version_stands_everywhere() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert PROJECT["version"] == __version__ == citation["version"]
    assert f"## {__version__}\n" in changes
    assert re.findall(r"^## (.*)$", changes, re.M)[0] == "Unreleased"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[zipfile.ZipFile]:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as opened:
        yield opened


def test_the_wheel_holds_what_is_no_python(wheel: zipfile.ZipFile) -> None:
    held = set(wheel.namelist())
    sources = {one for room in ("ronnaplan", "phantoms", "kernelcache") for one in (ROOT / room).rglob("*")}
    needed = {
        one.relative_to(ROOT).as_posix() for one in sources if one.is_file() and "__pycache__" not in one.parts
    }
    assert needed <= held
    assert {"ronnaplan/py.typed", "ronnaplan/documents/schema/plan.schema.json"} <= held


def test_no_link_of_the_published_readme_leads_to_a_file(wheel: zipfile.ZipFile) -> None:
    """Who reads it has no files beside it; the text and the disclaimer are all there."""
    told = wheel.read(f"ronnaplan-{__version__}.dist-info/METADATA").decode()
    assert "Description-Content-Type: text/markdown" in told
    assert "not a medical device" in told
    assert "[`refine.py`]" not in told
    assert "(`refine.py`)" in told
    assert all(target.startswith("https://") for target in re.findall(r"\]\(([^)]*)\)", told))


def test_links_of_the_readme_lead_to_this_version_once_the_source_has_an_address() -> None:
    readme = "![A head](docs/a.png) [more](docs/b.md#c) [paper](https://doi.org/1) [top](#more)"
    assert _script("published_readme.py").published(readme, "1.2.3", "https://host/us") == (
        "![A head](https://host/us/blob/v1.2.3/docs/a.png?raw=true) [more](https://host/us/blob/v1.2.3/docs/b.md#c)"
        " [paper](https://doi.org/1) [top](#more)"
    )


def test_the_bill_of_materials_lists_every_pinned_package() -> None:
    done = subprocess.run([sys.executable, ROOT / "scripts" / "sbom"], capture_output=True, text=True, check=True)
    bill = json.loads(done.stdout)
    pinned = set(
        re.findall(r"^([\w.-]+==[^\s;]+)", (ROOT / "requirements.lock").read_text(encoding="utf-8"), re.M)
    )
    listed = {f"{one['name']}=={one['version']}" for one in bill["components"]}
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.5")
    assert bill["metadata"]["component"]["version"] == __version__
    assert listed == pinned
    assert all(one["externalReferences"][0]["hashes"] for one in bill["components"])


def test_continuous_integration_runs_the_declared_pythons_on_three_systems() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))["jobs"]
    matrix = jobs["systems"]["strategy"]["matrix"]
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos", "windows"}
    declared = {
        one.rsplit(" ", 1)[1]
        for one in PROJECT["classifiers"]
        if one.startswith("Programming Language :: Python :: 3.")
    }
    assert {*matrix["python"], jobs["all"]["steps"][1]["with"]["python-version"]} == declared
    named = jobs["extras"]["strategy"]["matrix"]["extra"]
    assert jobs["extras"]["steps"][-1]["run"] == "scripts/extras ${{ matrix.extra }}"
    assert set(named) == set(_script("extras").USES)


@pytest.mark.parametrize(
    "form", sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml")), ids=lambda one: one.stem
)
def test_an_issue_form_asks_only_what_the_host_knows(form: Path) -> None:
    """As GitHub's syntax for forms has it: an unknown key, such as the rest of an unquoted line, voids the form."""
    asked = yaml.safe_load(form.read_text(encoding="utf-8"))
    assert {"name", "description", "body"} <= set(asked)
    for part in asked["body"]:
        assert part["type"] in {"markdown", "input", "textarea"}
        assert set(part) <= {"type", "id", "attributes", "validations"}
        assert set(part["attributes"]) <= {"label", "description", "placeholder", "value", "render"}
        assert all(part["attributes"].values())


def test_a_part_of_the_lock_is_what_an_extra_needs_with_hashes() -> None:
    lock = """
one==1.0 \\
    --hash=sha256:aa
    # via ronnaplan (pyproject.toml)
two==2.0 ; sys_platform != 'win32' \\
    --hash=sha256:bb
    # via
    #   other
    #   one
two==2.1 ; sys_platform == 'win32' \\
    --hash=sha256:be
    # via
    #   other
    #   one
three==3.0 \\
    --hash=sha256:cc
    # via ronnaplan (pyproject.toml)
four==4.0 \\
    --hash=sha256:dd
    # via three
"""
    locked = _script("extras").locked
    project = {
        "dependencies": ["One>=0.5"],
        "optional-dependencies": {"more": ["three[x]>=2"], "all": ["ronnaplan[more]"]},
    }
    assert locked((), lock, project) == lock[1 : lock.index("three==")]
    assert locked(("all",), lock, project) == lock[1:]


def _script(name: str) -> ModuleType:
    """Return a program of ``scripts`` as a module."""
    loader = SourceFileLoader(name, str(ROOT / "scripts" / name))
    spec = spec_from_loader(name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module
