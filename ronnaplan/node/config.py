"""node.toml: who the node is, whom it talks to, what it does with which scan."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from ronnaplan.documents.fields import DocumentModel, Label, Line, require_different_names
from ronnaplan.documents.reading import read_settings
from ronnaplan.jobs.rules import JobLimits, ScanRule, Seconds

ANY_ADDRESS = "any"
"""A peer's host that stands for every address."""

AnswerKind = Literal["fiducials", "sr", "pdf", "sheet"]


def _title(text: str) -> str:
    if not re.fullmatch(r"[!-\[\]-~]([ -\[\]-~]{0,14}[!-\[\]-~])?", text):
        raise ValueError(
            "is no AE title: 1 to 16 printable ASCII characters, no backslash, no space at either end"
        )
    return text


AeTitle = Annotated[str, AfterValidator(_title)]
Port = Annotated[int, Field(ge=0, le=65_535)]
Count = Annotated[int, Field(ge=1, le=100_000)]


class Limits(DocumentModel):
    """What one peer, or all of them, may take of this machine."""

    associations: Annotated[int, Field(ge=1, le=100)] = 20
    largest_instance_mib: Count = 2048
    least_free_mib: Annotated[int, Field(ge=0, le=100_000_000)] = 1024
    """With less room than this on the disk nothing is taken (status A700)."""
    silent_s: Seconds = 30.0
    """A peer that sends nothing for so long, or has not sent a begun message whole, is cut off."""


class Tls(DocumentModel):
    """Certificates for encrypted associations, PEM files; both sides must show one that ``authorities`` signed."""

    certificate: Label
    key: Label
    authorities: Label


class Peer(DocumentModel):
    """Another node: a scanner or an archive."""

    name: Label
    title: AeTitle = "ANY-SCP"
    host: Label = "127.0.0.1"
    port: Port = 0
    sends: bool = False
    """Whether it may send scans here."""
    commits_when_done: bool = False
    """Whether it asks for storage commitment of a series only when it has sent all of it."""
    tls: bool = False
    url: Line | None = None
    """Where it takes answers by DICOMweb (STOW-RS), instead of C-STORE."""

    @property
    def reachable(self) -> bool:
        """Whether there is somewhere to send answers to."""
        return self.url is not None or (bool(self.port) and self.host != ANY_ADDRESS)

    @property
    def speaks(self) -> bool:
        """Whether it may ask for an association: to send, or to tell what it keeps."""
        return self.sends or bool(self.port)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.url is not None and not self.url.startswith(("http://", "https://")):
            raise ValueError("url: expected an address that starts with http:// or https://")
        return self


class Rule(ScanRule):
    """What is looked for in a complete series, and who gets which answers."""

    patterns: ClassVar = (*ScanRule.patterns, "calling", "called")

    calling: Line = "*"
    called: Line = "*"
    answers: tuple[AnswerKind, ...] = ("fiducials", "sr", "pdf", "sheet")
    receivers: tuple[Label, ...] = ()
    """Names of the peers that get the answers."""
    documents: Label | None = None
    """A folder with a folder for each study, named by its UID: its registration.json and plan.json are answers, too."""


class Jobs(JobLimits):
    """How work is done."""

    workers: Annotated[int, Field(ge=1, le=64)] = 1
    attempts: Annotated[int, Field(ge=1, le=100)] = 4
    retry_s: Seconds = 30.0
    """Wait before the second attempt at a job or a delivery; doubled for each further one, up to an hour."""


class Config(DocumentModel):
    """The whole of node.toml; ``home`` is the folder that its relative paths start from."""

    home: Path = Path()
    folder: Label = "node-data"
    titles: tuple[AeTitle, ...] = ("RONNAPLAN",)
    host: Label = "127.0.0.1"
    port: Port = 11112
    page_port: Port | None = None
    """Of the status page on this machine; 0 any that is free, None for no page."""
    quiet_s: Seconds = 10.0
    """A series to which nothing was added for so long is complete."""
    missing_s: Seconds = 120.0
    """A series that is known to miss instances is worked on all the same when nothing was added for so long."""
    keep_days: Annotated[float, Field(gt=0, le=36_500)] = 30.0
    names_in_logs: bool = False
    audit: Label = "audit.log"
    """A file in the folder, or syslog://HOST:PORT."""
    limits: Limits = Limits()
    jobs: Jobs = Jobs()
    tls: Tls | None = None
    peer: tuple[Peer, ...] = ()
    rule: tuple[Rule, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [one.name for one in self.peer]
        require_different_names("peers", names)
        require_different_names("rules", [one.name for one in self.rule])
        for rule in self.rule:
            unknown = sorted(set(rule.receivers) - set(names))
            if unknown:
                raise ValueError(f"rule {rule.name} names a receiver {unknown[0]} that is no peer")
            lost = [one.name for one in self.peer if one.name in rule.receivers and not one.reachable]
            if lost:
                raise ValueError(
                    f"rule {rule.name} names the receiver {lost[0]}, but its peer states nowhere to send to; give its "
                    "host and port, or its url"
                )
        if not self.titles:
            raise ValueError("titles: at least one AE title is needed")
        if self.page_port == self.port != 0:
            raise ValueError(f"page_port: {self.port} is the port that peers send to; choose another one")
        if self.tls is None and any(one.tls for one in self.peer):
            raise ValueError("a peer asks for TLS, for which a [tls] table with certificates is needed")
        return self

    @property
    def data(self) -> Path:
        """The folder that holds all the node keeps."""
        return self.home / self.folder

    def named(self, name: str) -> Peer | None:
        """Return the peer called ``name``."""
        return next((one for one in self.peer if one.name == name), None)


def read_config(path: str | Path) -> Config:
    """Read node.toml; raises `InputError` naming the first thing that is wrong."""
    remedy = "--init writes an example"
    return read_settings(
        path, Config, expected="a node's configuration", otherwise="is not a node's configuration", remedy=remedy
    )


EXAMPLE = """\
# What `ronnaplan node --config node.toml` does. Paths are relative to this file.

folder = "node-data"            # everything the node keeps: scans, index, answers
titles = ["RONNAPLAN"]          # AE titles it answers to; rules can tell them apart
host = "127.0.0.1"              # the one address to listen on; this machine only until you change it
port = 11112
page_port = 11180               # status page and /metrics, on this machine only; leave out for none
quiet_s = 10.0                  # a series is complete when nothing was added for so long
missing_s = 120.0               # one that is known to miss instances: when nothing was added for so long
keep_days = 30.0                # then a scan is removed, once its answers are delivered
names_in_logs = false           # true writes patients' names to the log
audit = "audit.log"             # DICOM audit messages: a file in the folder, or "syslog://HOST:514"

[limits]
associations = 20               # at one time
largest_instance_mib = 2048
least_free_mib = 1024           # with less room on the disk nothing is taken (status A700)
silent_s = 30.0                 # a peer that hangs is cut off

[jobs]
workers = 1                     # scans worked on at one time
seconds = 600.0                 # then a job is ended and tried again
memory_mib = 4096               # of one job
attempts = 4
retry_s = 30.0                  # before the second attempt, doubled for each further one

# Encrypted associations (BCP 195), both sides with certificates:
# [tls]
# certificate = "node.pem"
# key = "node.key"
# authorities = "authorities.pem"

[[peer]]
name = "scanner"
title = "CT1"
host = "127.0.0.1"              # "any" for every address
sends = true                    # it may send scans here
# port = 104                    # where it is told what is kept, when it asks for storage commitment
# commits_when_done = true      # it asks when it has sent all of a series, which then is complete at once

[[peer]]
name = "pacs"
title = "ORTHANC"
host = "127.0.0.1"
port = 4242
# url = "https://pacs.example/dicom-web"    # sends by STOW-RS instead

[[rule]]                        # the first rule that fits a complete series decides
name = "skin markers"
calling = "*"                   # patterns: AE titles, station, series description, protocol
called = "RONNAPLAN"
station = "*"
description = "*"
protocol = "*"
diameters = [11.5]              # mm; leave out to have one size found
expected = 6                    # refuse unless so many are found; leave out for any number
# template = "frame.json"
answers = ["fiducials", "sr", "pdf", "sheet"]
receivers = ["pacs"]
# documents = "documents"       # registration.json and plan.json in its folder STUDY_UID are sent, too
"""
"""What ``--init`` writes."""
