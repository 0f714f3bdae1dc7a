"""A scripted module of 3D Slicer: the markers of a CT as a point list, found by the ``ronnaplan`` command.

The command runs in its own environment and process; nothing is installed into Slicer's Python.
"""

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import ctk
import qt
import slicer
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleWidget,
)


class RonnaplanLocalize(ScriptedLoadableModule):
    """What Slicer lists."""

    def __init__(self, parent: Any) -> None:
        super().__init__(parent)
        parent.title = "ronnaplan: localize markers"
        parent.categories = ["IGT"]
        parent.contributors = ["the ronnaplan contributors"]
        parent.helpText = "Finds spherical markers in a head CT. Research software, not a medical device."


class RonnaplanLocalizeWidget(ScriptedLoadableModuleWidget):
    """A folder, a diameter, a button, and what was said."""

    def setup(self) -> None:
        """Lay out the panel."""
        super().setup()
        self.logic = RonnaplanLocalizeLogic()
        self.path = ctk.ctkPathLineEdit()
        self.path.filters = ctk.ctkPathLineEdit.Files | ctk.ctkPathLineEdit.Dirs
        self.diameter = ctk.ctkDoubleSpinBox()
        self.diameter.minimum, self.diameter.maximum, self.diameter.value = 2.0, 60.0, 11.5
        self.diameter.suffix = " mm"
        button = qt.QPushButton("Localize")
        button.connect("clicked()", self.onLocalize)
        self.said = qt.QPlainTextEdit()
        self.said.readOnly = True
        form = qt.QFormLayout()
        form.addRow("DICOM folder or image", self.path)
        form.addRow("Diameter", self.diameter)
        form.addRow(button)
        form.addRow(self.said)
        self.layout.addLayout(form)
        self.layout.addStretch(1)

    def onLocalize(self) -> None:
        """Run the command; show what it said."""
        with slicer.util.tryWithErrorDisplay("The markers were not found.", waitCursor=True):
            self.said.plainText = self.logic.localize(self.path.currentPath, self.diameter.value)


class RonnaplanLocalizeLogic(ScriptedLoadableModuleLogic):
    """The command line, called twice: to localize and to export."""

    def localize(self, path: str, diameter_mm: float) -> str:
        """Load the markers of the scan at ``path`` as a point list; return what the command said of them."""
        with tempfile.TemporaryDirectory() as folder:
            found, points = Path(folder) / "fiducials.json", Path(folder) / "markers.mrk.json"
            said = self.run("localize", path, "--diameter", f"{diameter_mm:g}", "-o", str(found))
            self.run("export", str(found), "--to", "markups", "-o", str(points))
            slicer.util.loadMarkups(str(points))
        return said

    @staticmethod
    def run(*arguments: str) -> str:
        """Run ``ronnaplan`` in the environment that Slicer was started from; return what it said, or raise it."""
        command = os.environ.get("RONNAPLAN") or shutil.which("ronnaplan")
        if not command:
            raise RuntimeError(
                "the command 'ronnaplan' was not found; set RONNAPLAN to its path and start Slicer again"
            )
        process = slicer.util.launchConsoleProcess([command, *arguments])
        said: str = process.communicate()[0]
        if process.returncode != 0:
            raise RuntimeError(said)
        return said
