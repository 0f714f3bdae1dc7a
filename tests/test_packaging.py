"""What goes with a release agrees with the package: versions, the bill of materials, continuous integration."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

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
    extras = {one.strip("[]") for one in jobs["extras"]["strategy"]["matrix"]["extra"]} - {""}
    assert extras <= set(PROJECT["optional-dependencies"])
