"""An HTML page printed to PDF by Chromium, where there is one."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from ronnaplan.errors import InputError
from ronnaplan.portable import is_administrator

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
TIME_LIMIT_S = 120

FLAGS = (
    *("--headless", "--disable-gpu", "--no-first-run", "--no-pdf-header-footer", "--disable-extensions"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic"),
)
"""Print, and speak to nobody."""


def find_browser() -> str | None:
    """Return the path of a Chromium, or None."""
    return next((found for found in map(shutil.which, BROWSERS) if found), None)


def print_pdf(html: str) -> bytes:
    """Return the page as PDF; raises `InputError` where no Chromium is installed or it fails."""
    browser = find_browser()
    if browser is None:
        raise InputError(
            f"no Chromium was found to print a PDF (tried {', '.join(BROWSERS)}); write .html instead"
        )
    with tempfile.TemporaryDirectory(prefix="ronnaplan-") as folder:
        source, printed = Path(folder) / "report.html", Path(folder) / "report.pdf"
        source.write_text(html, encoding="utf-8")
        # Chromium refuses to run as root inside its sandbox; the page it prints runs no script.
        sandbox = ("--no-sandbox",) if is_administrator() else ()
        command = [browser, *FLAGS, *sandbox, f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}"]
        try:
            subprocess.run([*command, source.as_uri()], check=True, capture_output=True, timeout=TIME_LIMIT_S)
            return printed.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            raise InputError(f"{browser} could not print the report; write .html and print that") from error
