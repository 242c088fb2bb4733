"""A run, a trial or a reproduced paper as tables, figures and an HTML page.

`pamid.report` is this package, and what is done with a run: called, it writes the page. The face
has no other way to give both the name, and code that imports modules of the package is not
disturbed by it.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any


class _CallableReport(ModuleType):
    def __call__(
        self,
        run: Any,
        output: str | os.PathLike[str] | None = None,
        *,
        pdf: str | os.PathLike[str] | None = None,
        rig: str | os.PathLike[str] | None = None,
        overwrite: bool = False,
    ) -> Any:
        """Write the page of a run and its figures; see `pamid.report.writing.write_report`.

        Parameters
        ----------
        run
            Folder of a run, a trial or a paper, or a result.
        output
            Page to write. Default: report.html in that folder.
        pdf
            PDF file with the same content.
        rig
            Rig file of the run (it is run), for the animation of its pose.
        overwrite
            Also replace a file that is not a report.
        """
        from pamid.report.writing import write_report

        return write_report(
            Path(getattr(run, "folder", run)),
            None if output is None else Path(output),
            None if pdf is None else Path(pdf),
            rig=None if rig is None else os.fspath(rig),
            overwrite=overwrite,
        )


sys.modules[__name__].__class__ = _CallableReport
