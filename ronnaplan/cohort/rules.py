"""rules.toml: what is looked for in which series, and how much time and memory each may take."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, model_validator

from ronnaplan import __version__
from ronnaplan.documents.fields import DocumentModel, Line, require_different_names
from ronnaplan.documents.reading import read_settings
from ronnaplan.jobs.rules import JobLimits, ScanRule

RESULTS = 1
"""Counts the changes of what is kept of a series: another number has all done anew."""


class CohortRule(ScanRule):
    """What is looked for in a series, wherever it lies and whatever took it."""

    patterns: ClassVar = (*ScanRule.patterns, "study", "device", "folder")

    study: Line = "*"
    device: Line = "*"
    folder: Line = "*"
    phantom: Line | None = None
    """The truth about a known phantom, a template or fiducials.json: its scans are charted."""
    sheet: bool = True
    """Whether the contact sheet is drawn."""


class Limits(JobLimits):
    """What one series may take."""

    attempts: Annotated[int, Field(ge=1, le=1000)] = 3
    """How often a series is tried whose process died: somebody else may have ended it."""


class Rules(DocumentModel):
    """The whole of rules.toml; ``home`` is the folder that its relative paths start from."""

    home: Path = Path()
    limits: Limits = Limits()
    rule: tuple[CohortRule, ...] = (CohortRule(name="all"),)

    @model_validator(mode="after")
    def _check(self) -> Self:
        require_different_names("rules", [one.name for one in self.rule])
        return self


class Task:
    """A rule with its documents read, as it is sent to a worker; ``settings`` tells it from what does otherwise."""

    def __init__(self, rule: CohortRule, home: Path) -> None:
        from ronnaplan.documents.phantom_check import read_truth
        from ronnaplan.documents.template import read_template_document

        template = None if rule.template is None else read_template_document(home / rule.template)
        phantom = None if rule.phantom is None else read_truth(home / rule.phantom)
        self.rule = rule
        self.order: dict[str, Any] = {
            "rule": rule.model_dump(mode="json"),
            "template": None if template is None else template.model_dump(mode="json"),
            "phantom": None if phantom is None else phantom.model_dump(mode="json"),
        }
        given = {**self.order, "rule": rule.model_dump(mode="json", exclude={"name", *rule.patterns})}
        text = json.dumps([RESULTS, __version__, given], sort_keys=True)
        self.settings = hashlib.sha256(text.encode()).hexdigest()[:32]


def read_rules(path: str | Path) -> Rules:
    """Read rules.toml; raises `InputError` naming the first thing that is wrong."""
    remedy = "--init writes an example"
    return read_settings(
        path, Rules, expected="a cohort's rules", otherwise="are no rules for a cohort", remedy=remedy
    )


EXAMPLE = """\
# What `ronnaplan cohort ROOT... -o OUT --rules rules.toml` looks for. Paths are relative to this file.

[limits]                        # of one series; what takes more is set aside, with its reason
seconds = 600.0
memory_mib = 4096
attempts = 3                    # of a series whose process died, for somebody else may have ended it

[[rule]]                        # the first rule that fits a series decides; what fits none is left alone
name = "daily phantom"
folder = "*phantom*"            # patterns, * and ? as in file names, any case: the folder below the root,
                                # archives in it too ("phantoms/2026.zip/1"),
device = "*"                    # "maker model serial number",
station = "*"                   # station name,
study = "*"                     # study description,
description = "*"               # series description,
protocol = "*"                  # protocol name,
modality = "CT"
diameters = [11.5]              # mm; leave out to have one size found
marker = "solid"                # or "shell:WALL", "wrapped:THICKNESS" (mm)
expected = 6                    # another number is refused; leave out for any number
# template = "frame.json"       # keep and label this frame's markers only
# phantom = "phantom.json"      # a known phantom (template or fiducials.json): its scans are charted by scanner
sheet = true                    # draw the contact sheet

[[rule]]
name = "all others"
"""
"""What ``--init`` writes."""
