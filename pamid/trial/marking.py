"""Scores of a case of the trial: its label and the answer of the diagnosis.

A case names a cause where its verdict has causes; a ranking below an abstention names nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pamid.base.schemas.diagnosis_file import CAUSED
from pamid.trial.cases import OPEN

LEAST_VISIBILITY = 1.1  # visibility from which a fault has to be named
MATERIAL = 0.15  # share of the refitted error from which an effect of an open case has to be named
MATERIAL_REMAINDER = 0.2  # share of the gap from which the place of what remains has to be reported
OPEN_ANSWERS = ("leader", "lesser", "wrong", "left-open")


@dataclass(frozen=True, eq=False)
class Marked:
    """A case: its label, its result, and their comparison."""

    label: dict[str, Any]
    result: dict[str, Any]

    @property
    def stratum(self) -> str:
        return str(self.label["stratum"])

    @property
    def conditions(self) -> dict[str, Any]:
        conditions: dict[str, Any] = self.label["conditions"]
        return conditions

    @property
    def truth(self) -> list[dict[str, Any]]:
        truth: list[dict[str, Any]] = self.label["truth"]
        return truth

    @property
    def opened(self) -> bool:
        """Do further effects act in this case, and poor maps and loggers?"""
        return self.label.get("world") == OPEN

    @property
    def present(self) -> list[dict[str, Any]]:
        """Effects that act and that the tool's catalogue has; largest share first."""
        if self.opened:
            return [a for a in self.result["acting"] if a["family"]]
        return self.truth if self.stratum in ("single", "double") else []

    @property
    def lead(self) -> dict[str, Any]:
        """Effect to be named first: the planted effect or, in an open case, the effect that removes
        most. IndexError where nothing acts."""
        lead: dict[str, Any] = (self.result["acting"] if self.opened else self.truth)[0]
        return lead

    @property
    def family(self) -> str:
        return str(self.lead["family"])

    @property
    def material(self) -> bool:
        """Whether the largest cause removes a material share of the refitted error."""
        return self.visibility * (1.0 - MATERIAL) >= 1.0

    @property
    def visibility(self) -> float:
        return float(self.result["visibility"] or 0.0)

    @property
    def visible(self) -> bool:
        return self.visibility >= LEAST_VISIBILITY

    @property
    def each_visible(self) -> bool:
        """Whether every planted fault is visible in addition to the others."""
        return float(self.result["visibility_each"] or 0.0) >= LEAST_VISIBILITY

    @property
    def diagnosis(self) -> dict[str, Any]:
        diagnosis: dict[str, Any] = self.result["diagnosis"]
        return diagnosis

    @property
    def verdict(self) -> str:
        return str(self.diagnosis["verdict"])

    @property
    def names(self) -> bool:
        return self.verdict in CAUSED

    @property
    def alarms(self) -> bool:
        return self.verdict not in ("no-structural-gap", "cannot-tell")

    @property
    def abstains(self) -> bool:
        return self.verdict == "unknown-effect"

    @property
    def leaves_nameless(self) -> bool:
        """Whether the answer blames nothing and reports a material remainder, whatever its verdict.
        A cause next to a remainder above half may be a lesser effect."""
        rest = self.diagnosis.get("remainder") or {}
        if self.names:
            return float(rest.get("share") or 0.0) > 0.5
        return self.abstains or bool(rest.get("real"))

    @cached_property
    def open_answer(self) -> str:
        """Kind of answer to the effect that removes most, in an open case.

        "leader": named first, or in a set; a set of more than two families is named as a group
        that predicts the same. "lesser": only effects of other families that act were named.
        "wrong": none that is named acts. "left-open": nothing is named."""
        if not self.names or not self.causes:
            return "left-open"
        together = self.causes if self.verdict == "ambiguous" else self.causes[:1]
        if any(_is_of(c, self.lead) for c in together):
            return "leader"  # a larger set is only named where all of it predicts the same
        acts = any(_is_of(c, name) for c in self.causes for name in self.present)
        return "lesser" if acts else "wrong"

    @property
    def remainder_reported(self) -> bool:
        """Whether the answer states the size of the remainder and, if it is material, its place."""
        rest = self.diagnosis.get("remainder") or {}
        share = rest.get("share")
        return share is not None and (share < MATERIAL_REMAINDER or bool(rest.get("port")))

    @property
    def claims_hold(self) -> bool:
        """Whether the named effects remove as much of a fresh recording's error as claimed."""
        forecast = self.result["shrinkage"]
        return forecast is None or forecast["achieved"] >= forecast["low"]

    @property
    def open_right(self) -> bool:
        """Leader named, remainder reported, and nothing named that removes less than claimed."""
        return self.open_answer == "leader" and self.remainder_reported and self.claims_hold

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Effects that the verdict names, the strongest first."""
        causes: list[dict[str, Any]] = self.diagnosis["causes"]
        return causes

    def is_right(self, table: dict[str, Any]) -> bool:
        """Does an effect (with its family and port) act, or an effect of the same family at the
        same port? An exact equivalent may act elsewhere, unless the fault has a place
        (fault@place)."""
        return any(
            (table["family"] == t["family"] and table["port"] == t["port"]) or _is_exact(table, t)
            for t in self.present
        )

    @cached_property
    def wrong_beside_right(self) -> bool:
        """Whether the answer has a wrong probable cause in addition to a right cause."""
        right = [self.is_right(c) for c in self.causes]
        likely = [float(c["probability"]) > 0.5 for c in self.causes]
        return any(right) and any(p and not r for r, p in zip(right, likely, strict=True))

    @cached_property
    def ranking(self) -> list[dict[str, Any]]:
        """Candidates that were refitted, best first."""
        return [r for r in self.diagnosis["ranking"] if r["family"]]

    @cached_property
    def families(self) -> list[str]:
        """Families in the order of their best member."""
        return list(dict.fromkeys(str(r["family"]) for r in self.ranking))

    @property
    def answer(self) -> str:
        """The family named first, or how naming a family was avoided."""
        if self.names:
            return str(self.causes[0]["family"])
        if self.verdict == "cannot-tell":
            return "(cannot tell)"
        return "(unknown effect)" if self.abstains else "(no gap)"

    @cached_property
    def exact_first(self) -> bool:
        """Whether the first of the ranking is the fault itself, or an effect that these recordings
        cannot separate from it."""
        exact = set(self.lead["exact"])
        if not self.ranking:
            return False
        top = self.ranking[0]["effect"]
        tied = {m["effect"] for step in self.diagnosis["comparison"][:1] for m in step["tied"]}
        return bool(exact & {_bare(name) for name in (tied if top in tied else {top})})

    @cached_property
    def port_right(self) -> bool:
        """Is the gap placed at the fault's port, at a port indistinguishable from it, or at an
        exact equivalent? A fault with a place (fault@place) has none: the same effect elsewhere is
        wrong.
        """
        where, truth = self.diagnosis["where"], self.lead
        if not self.alarms:
            return False
        same = {
            where["port"],
            *(p for group in where["indistinguishable"] if where["port"] in group for p in group),
        }
        twin = any(c["port"] == where["port"] and _is_exact(c, truth) for c in self.causes)
        return truth["port"] in same or twin

    @cached_property
    def port_exact(self) -> bool:
        """Whether the first of the ranking acts exactly at the port of the fault."""
        return self.alarms and bool(self.ranking) and self.ranking[0]["port"] == self.lead["port"]

    @cached_property
    def caught(self) -> int:
        """How many of the planted families are among the causes."""
        return len({t["family"] for t in self.truth} & {c["family"] for c in self.causes})


def _is_exact(named: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Is a named effect an exact equivalent, wherever it acts? A fault with a place (fault@place)
    has none elsewhere."""
    return "@" not in truth["fault"] and _bare(named["effect"]) in truth["exact"]


def _is_of(named: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Is a named effect of the family of an acting effect, or its exact equivalent?"""
    return named["family"] == truth["family"] or _is_exact(named, truth)


def _bare(effect: str) -> str:
    """coulomb-friction@joint_2 -> coulomb-friction"""
    return effect.partition("@")[0]
