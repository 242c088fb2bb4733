"""A run, a trial or a reproduced paper as tables, figures and one HTML page.

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

        run: the folder of a run, a trial or a paper, or a result that has one; output: the page
        [default: report.html in that folder]; pdf: a file for the same on paper; rig: the file of
        the run's rig, which is run, for the animation of its pose; overwrite: replace the page also
        where it is no report.
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
