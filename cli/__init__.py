"""The command line of pamid (installed as the package `pamid_cli`): a file per command, loaded
when it is called."""

from .frame import main

__all__ = ["main"]
