"""An HTML page printed to PDF by Chromium, or Chrome or Edge, which are made of it, where there is one."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from ronnaplan.errors import InputError, UnwrittenError
from ronnaplan.portable import is_administrator, kill_all

BROWSERS = (
    "chromium-headless-shell",
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge", "msedge"),
    *(
        f"/Applications/{name}.app/Contents/MacOS/{name}"
        for name in ("Google Chrome", "Chromium", "Microsoft Edge")
    ),
    r"%ProgramFiles%\Google\Chrome\Application\chrome.exe",
    r"%ProgramFiles(x86)%\Microsoft\Edge\Application\msedge.exe",
)
"""Commands, and where macOS and Windows install what no command starts there.

The first is Chromium without windows of its own, which prints in less than half the processor's time."""

TIME_LIMIT_S = 120

ROOM_BYTES = 16 * 2**20
"""What Chromium keeps for itself while it prints, and a long report, take less."""

FLAGS = (
    *("--headless", "--disable-gpu", "--no-first-run", "--no-pdf-header-footer", "--disable-extensions"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic"),
)
"""Print, and speak to nobody."""


def find_browser() -> str | None:
    """Return the path of a Chromium, Chrome or Edge, or None."""
    return next((found for name in BROWSERS if (found := shutil.which(os.path.expandvars(name)))), None)


def print_pdf(html: str, below: Path | None = None) -> bytes:
    """Return the page as PDF, made in a folder of its own ``below`` a folder, or the system's for what is temporary.

    Raises `UnwrittenError` where the disk has no room to print it, `InputError` where no Chromium is installed or it
    fails otherwise.
    """
    browser = find_browser()
    if browser is None:
        raise InputError(
            "neither Chromium nor Chrome nor Edge was found to print a PDF; install one, or write .html instead"
        )
    with tempfile.TemporaryDirectory(prefix="ronnaplan-", dir=below) as folder:
        try:
            printed = _printed(browser, html, Path(folder))
        except subprocess.TimeoutExpired as error:
            raise InputError(
                f"{browser} had not printed the report after {TIME_LIMIT_S} s, as of hundreds of trajectories or on a "
                "busy machine; try again, or write .html and print that"
            ) from error
        except (OSError, subprocess.SubprocessError) as error:
            raise _unprinted(browser, Path(folder)) from error
        # Chromium ends well where the disk took half of it, or nothing.
        if not (printed.startswith(b"%PDF-") and printed.rstrip().endswith(b"%%EOF")):
            raise _unprinted(browser, Path(folder))
        return printed


def _printed(browser: str, html: str, folder: Path) -> bytes:
    source, printed = folder / "report.html", folder / "report.pdf"
    source.write_text(html, encoding="utf-8")
    # Chromium refuses to run as root inside its sandbox; the page it prints runs no script.
    sandbox = ("--no-sandbox",) if is_administrator() else ()
    command = [browser, *FLAGS, *sandbox, f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}"]
    quiet = subprocess.DEVNULL
    process = subprocess.Popen([*command, source.as_uri()], stdin=quiet, stdout=quiet, stderr=quiet)
    try:
        status = process.wait(TIME_LIMIT_S)
    except BaseException:  # given up, it would go on, and write into a folder that is removed
        kill_all(process)
        process.wait()
        raise
    if status:
        raise subprocess.CalledProcessError(status, browser)
    return printed.read_bytes()


def _unprinted(browser: str, folder: Path) -> InputError:
    """Return why nothing was printed into ``folder``."""
    try:
        (folder / "room").write_bytes(bytes(ROOM_BYTES))
    except OSError as error:
        return UnwrittenError(
            f"there is no room to print the report in {folder.parent} ({error.strerror or error}); make room there"
        )
    return InputError(f"{browser} could not print the report; write .html and print that")
