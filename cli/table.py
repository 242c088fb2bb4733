"""The commands: where each one lives, and one line of help, so that `pamid --help` need not load
any of them."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

import click

#: name -> (module:function inside this package, one line of help)
COMMANDS: dict[str, tuple[str, str]] = {
    "generate-aprbs": (
        "generate_aprbs:command",
        "Make an excitation that covers amplitude and frequency.",
    ),
    "simulate": ("simulate:command", "Run a virtual rig with any effects and sensor noise."),
    "ingest": (
        "ingest:command",
        "Turn raw logs into recordings: columns, units, an even time base.",
    ),
    "check": (
        "check:command",
        "Say what is wrong with a recording, rig or effect, before any fitting.",
    ),
    "fit": ("fit:command", "Fit the parameters of a rig to recordings, with intervals."),
    "train-residual": (
        "train_residual:command",
        "Train a network on what a fitted model leaves over.",
    ),
    "force-law": (
        "force_law:command",
        "Train a muscle's force law on a measured map, beside the analytic ones.",
    ),
    "diagnose": (
        "diagnose:command",
        "Find where the gap lies, which effect causes it, how far it shrinks.",
    ),
    "reproduce-paper": (
        "reproduce_paper:command",
        "The results of the two papers, on calibrated virtual rigs.",
    ),
    "trial": (
        "trial:command",
        "The blind trial of the diagnosis: drawn cases with hidden labels, scored.",
    ),
    "report": ("report:command", "Turn a run into tables, figures and one HTML page."),
    "export": ("export:command", "Write an identified model as FMU, C, ONNX or MATLAB function."),
    "animate": (
        "animate:command",
        "Show how a run's rig moved, measured over simulated, as a GIF.",
    ),
    "effects": ("effects:command", "List the catalogue of effects, or explain one."),
    "rigs": ("rigs:command", "List the rigs, or explain one."),
    "schema": ("schema:command", "List or print the JSON schemas of results and files."),
    "config": ("config:command", "Show the value of every option, and where it comes from."),
    "completion": (
        "completion:command",
        "Print what your shell needs to complete pamid's commands.",
    ),
    "demo": ("demo:command", "Everything above on a virtual rig, in about a minute."),
}


def load_command(name: str) -> click.Command:
    """A command by its name; imports its module."""
    module, _, attribute = COMMANDS[name][0].partition(":")
    found = getattr(importlib.import_module(f".{module}", __package__), attribute)
    assert isinstance(found, click.Command)
    return found


def every_command() -> Iterator[click.Command]:
    """All commands there are; imports all their modules."""
    return map(load_command, COMMANDS)
