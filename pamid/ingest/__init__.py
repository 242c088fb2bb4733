"""Raw logs in: readers, a mapping, the time base, units; out come recordings.

`pamid.ingest` is this package, and what is done with a log: called, it makes recordings.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _CallableIngest(ModuleType):
    def __call__(self, *logs_and_mapping: Any, **options: Any) -> Any:
        """Turn raw logs into recordings; see `pamid.ingest.ingesting.ingest`."""
        from pamid.ingest.ingesting import ingest

        return ingest(*logs_and_mapping, **options)


sys.modules[__name__].__class__ = _CallableIngest
