"""The machine of a case, its recordings, and which effects act in them.

A further effect of an open case is scaled until its change of the held-out readings is the drawn
share of the planted effect's. Both changes are measured on the machine itself: two runs on the same
commands, with and without the effect. The diagnosis has no part in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError
from pamid.base.files import make_folder
from pamid.base.schemas.trial_case_files import ActingEffect
from pamid.model.rig import Rig
from pamid.recording.recording import TIME, Recording, read_recording, write_recording
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.trial.cases import FURTHER_SHARES, OPEN, Case
from pamid.trial.conditions import StarterConditions
from pamid.trial.machine import Machine, Record

Faults = Mapping[str, Mapping[str, float]]

FITTED, HELD_OUT = range(2)  # recordings of a case; the numbers above are fresh ones
LARGEST_SCALING = 3.0  # times a further effect's drawn size
SCALINGS = 8  # runs in which its size is sought
SCALED_TO = 0.1  # of the share that was drawn


@dataclass(frozen=True)
class RecordedCase:
    """A case as files, with the truth.

    rig         what the tool is given of the machine
    fitted, held_out, fresh  recordings: for the fit, for the comparison, and seen by nothing
    acting      what is there in an open case, the effect that removes most first
    """

    case: Case
    rig: Rig
    fitted: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    fresh: tuple[Recording, ...]
    acting: tuple[ActingEffect, ...]

    @property
    def data(self) -> DataSplit:
        """Data that the tool is given."""
        return split_recordings(self.rig, [*self.fitted], [*self.held_out])


@dataclass(frozen=True)
class CaseMachine:
    """The machine of a case. seeds: excitation and noise of the first two recordings."""

    case: Case
    machine: Machine
    record: Record
    seeds: tuple[int, ...]

    @classmethod
    def of(cls, case: Case) -> CaseMachine:
        random, machine = np.random.default_rng(case.seed), case.machine
        seeds = tuple(int(s) for s in random.integers(2**31, size=4))
        return cls(case, machine, machine.build(random, case.conditions), seeds)

    def run(self, faults: Faults, number: int = FITTED) -> dict[str, Array]:
        """Columns of a recording."""
        columns = self._run(faults, number, self._signal(number, self.case.conditions.loop))
        if self._gauge is not None:
            name, low, high = self._gauge
            logger = self.case.conditions.logger
            columns[name] = logger.read_by_gauge(columns[name], low, high)
        return columns

    def recording(self, faults: Faults, path: Path, number: int = FITTED) -> Recording:
        """A recording as a user has it: a file with the channels of the case, read back."""
        case, columns = self.case, self.run(faults, number)
        c, machine = case.conditions, case.machine
        meta: dict[str, Any] = {
            "recording": {"rig": case.rig, "loop": c.loop, "sampling_period_s": machine.period_s},
            "known": machine.known(c),
        }
        if c.loop == "closed":
            meta["controller"] = dict(machine.controller)
        if case.given_machine is not None and isinstance(c, StarterConditions):
            meta = case.given_machine.meta(c)
        visible = {k: v for k, v in columns.items() if k != TIME and not self._hidden(k)}
        write_recording(path, columns[TIME], visible, meta)
        return read_recording(path)

    def recorded(
        self, folder: Path, faults: Faults | None = None, *, fresh: int = 1
    ) -> RecordedCase:
        """The case as files: recording.csv and, in an open case, held-out.csv; then as many fresh
        recordings (fresh-1.csv ...). faults: what acts in their place."""
        make_folder(folder)
        case = self.case
        acting = self.faults if faults is None else faults
        opened = case.world == OPEN
        held_out = [("held-out", HELD_OUT)] if opened else []
        later = [(f"fresh-{k + 1}", HELD_OUT + opened + k) for k in range(fresh)]

        def recordings(*wanted: tuple[str, int]) -> tuple[Recording, ...]:
            return tuple(
                self.recording(acting, folder / f"{name}.csv", number) for name, number in wanted
            )

        return RecordedCase(
            case=case,
            rig=case.tools_rig,
            fitted=recordings(("recording", FITTED)),
            held_out=recordings(*held_out),
            fresh=recordings(*later),
            acting=self.acting if opened and faults is None else (),
        )

    @cached_property
    def faults(self) -> dict[str, dict[str, float]]:
        """All that acts in this machine, with its sizes: planted, then further."""
        case, acting = self.case, dict(self.case.planted)
        families = {case.machine.truth(site)["family"] for site in acting}
        candidates = iter(case.further.items())
        for share in case.shares:
            for site, drawn in candidates:
                family = case.machine.truth(site)["family"]
                sizes = None if family in families else self._scaled(site, drawn, share)
                if sizes is None:
                    continue
                with suppress(UsageError):  # two set the same size, or the machine flies apart
                    if np.isfinite(self.change({**acting, site: sizes})):
                        acting[site] = sizes
                        families.add(family)
                        break
        return acting

    @cached_property
    def acting(self) -> tuple[ActingEffect, ...]:
        """Effects that act, those that change the held-out readings most first."""
        effects = [
            ActingEffect(
                **self.case.machine.truth(site),
                planted=site in self.case.planted,
                change=self.change(self.faults, self.without(site)),
            )
            for site in self.faults
        ]
        return tuple(sorted(effects, key=lambda effect: -effect.change))

    def without(self, *sites: str) -> dict[str, dict[str, float]]:
        """All that acts, less these."""
        return {site: sizes for site, sizes in self.faults.items() if site not in sites}

    def change(self, faults: Faults, others: Faults | None = None) -> float:
        """Change of the held-out readings from `others` (default: nothing planted) to `faults`:
        root mean square in standard deviations of each reading, over all readings of the case.

        Both machines get the same commands, as both models of a comparison do: under a controller
        an effect would show in the commands instead."""
        was = self._healthy if others is None else self._run(others, HELD_OUT, self._commands)
        now = self._run(faults, HELD_OUT, self._commands)
        apart = [
            float(np.mean((now[k] - was[k]) ** 2)) / max(float(np.var(self._healthy[k])), 1e-24)
            for k in self.readings
        ]
        return float(np.sqrt(np.mean(apart)))

    @cached_property
    def readings(self) -> list[str]:
        """Columns that the tool sees and its rig explains."""
        return [k for k in self.case.tools_rig.outputs if not self._hidden(k)]

    @cached_property
    def _commands(self) -> Any:
        """Command to the healthy machine's actuators in the held-out recording."""
        return self._signal(HELD_OUT, "open")

    @cached_property
    def _healthy(self) -> dict[str, Array]:
        return self._run({}, HELD_OUT, self._commands)

    @cached_property
    def _gauge(self) -> tuple[str, float, float] | None:
        """The column with the coarse gauge, and its range."""
        name = self.case.conditions.logger.gauged(self.readings)
        if not name:
            return None
        signal = self._signal(FITTED, self.case.conditions.loop)
        healthy = self._run({}, FITTED, signal)[name]
        return name, float(healthy.min()), float(healthy.max())

    def _hidden(self, column: str) -> bool:
        return column.startswith(self.machine.withheld_columns[self.case.conditions.channels])

    def _seeds(self, number: int) -> tuple[int, int]:
        """Of the excitation and of the noise."""
        if number <= HELD_OUT:
            return self.seeds[2 * number], self.seeds[2 * number + 1]
        first, noise = np.random.default_rng([self.case.seed, number]).integers(2**31, size=2)
        return int(first), int(noise)

    def _signal(self, number: int, loop: str) -> Any:
        """Command, from before the recording starts; loop: "open" also for a closed case."""
        c = self.case.conditions
        seconds = c.seconds + self._warm_up * self.machine.period_s
        conditions = replace(c, loop=loop, seconds=seconds)
        return self.machine.excitation(conditions, self.record, *self._seeds(number))

    @property
    def _warm_up(self) -> int:
        """Samples before the recording starts."""
        return round(self.case.conditions.logger.warm_up_s / self.machine.period_s)

    def _run(self, faults: Faults, number: int, signal: Any) -> dict[str, Array]:
        """Columns before the gauge."""
        columns, start = self.record(faults, signal, self._seeds(number)[1]), self._warm_up
        time = columns[TIME][: len(columns[TIME]) - start]
        return {k: v[start:] for k, v in columns.items()} | {TIME: time}

    def _scaled(
        self, site: str, drawn: Mapping[str, float], share: float
    ) -> dict[str, float] | None:
        """Sizes with which a further effect changes the held-out readings by a share of what the
        planted effect does; None if no size does."""
        known = self.machine.faults
        fault = known.get(site) or known[site.partition("@")[0]]  # on the arm faults have places
        planted = self.change(self.case.planted)
        low, high = (limit * planted for limit in FURTHER_SHARES)
        factor = 1.0
        for _ in range(SCALINGS):
            sizes = {k: factor * v if k in fault.amounts else v for k, v in drawn.items()}
            try:
                change = self.change({site: sizes})
            except UsageError:
                factor *= 0.5
                continue
            wanted = share * planted
            if low <= change <= high and abs(change / wanted - 1.0) <= SCALED_TO:
                return sizes
            if change <= 0.0:
                return None
            factor = min(factor * wanted / change, LARGEST_SCALING)
        return sizes if low <= change <= high else None
