"""Passes of many starts of an Elman or NARX network by torch, all at once: on a CUDA device or,
with the same arithmetic, on the processor.

Both networks are a tanh layer x = tanh(W z + b), y = l x + c that sees values v of its past:
its states a sample before (Elman), or its outputs s, 2 s, ... samples before (NARX). Samples less
than s apart do not see each other there, so that a NARX record is s independent records of every
s-th sample, its phases; an Elman record is a single phase. Once all x are known, the derivatives V
= dv/dw obey a recursion that is linear in V,
    V(t+1) = P(t) V(t) + Q(t),
so that the record is cut into blocks of equal length that advance side by side, for all starts and
phases at once, each from V = 0 and with the transition Phi from its beginning as further columns. A
short loop over the blocks gives V at every block's beginning, and the rows are completed:
    dy/dw(t) = [row from V = 0](t) + [row of Phi](t) V(beginning of the block).
Results and column order are those of the networks' compiled kernels; sums are added up in another
order, so that the last digits differ.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.base.errors import DataError, UsageError
from pamid.networks.elman import Elman
from pamid.networks.narx import Narx
from pamid.networks.network import Network

if TYPE_CHECKING:
    from torch import Tensor

Sums = tuple[float, Array, Array]


def require_device(name: str) -> str:
    """The name of a device that torch can compute on: "cpu", "cuda", "cuda:1"; UsageError where
    there is none."""
    import torch

    known = re.fullmatch("cpu|cuda(?::([0-9]+))?", name)
    if not known:
        raise UsageError(
            f"There is no device {name!r}.",
            "Give cpu, cuda, or any of several GPUs, such as cuda:1.",
        )
    if name == "cpu":
        return name
    present = torch.cuda.device_count() if torch.cuda.is_available() else 0
    without = "or leave out --device: the compiled kernels need no graphics card."
    if not torch.version.cuda and not present:
        raise UsageError(
            f"torch sees no CUDA device here (torch {torch.__version__} is built without CUDA).",
            f"Install torch from PyPI, whose build for Linux has CUDA, {without}",
        )
    if not present:
        raise UsageError(
            "torch sees no CUDA device here.", f"Check the driver by nvidia-smi, {without}"
        )
    if int(known[1] or 0) >= present:
        last = f" to cuda:{present - 1}" if present > 1 else " only"
        raise UsageError(
            f"There is no device {name!r}: torch sees cuda:0{last}.", "Use --device cuda."
        )
    return name


def engine_on(
    device: str | None, network: Network, block: int = 256, memory: int = 2**30
) -> "TorchPasses | None":
    """The passes of a network on a device (see `TorchPasses`); None for the compiled kernels.

    UsageError for a device that is not there, or a network that has no passes in torch.
    """
    if device is None:
        return None
    for kind in (ElmanPasses, NarxPasses):
        if kind.computes is type(network):
            return kind(network, require_device(device), block, memory)
    raise UsageError(
        f"--device {device}: torch computes elman and narx networks, not {network.kind}.",
        "Leave out --device: the compiled kernels train every network.",
    )


class _Run(NamedTuple):
    """A simulation of all starts, step by step: of a sample of every phase.

    w: the weights (S, n); seen: what a unit sees, its bias' 1 included, in the order of its weights
    (S, steps, phases, per unit); hidden: x (S, steps, phases, h); y (S, steps, phases).
    """

    w: "Tensor"
    seen: "Tensor"
    hidden: "Tensor"
    y: "Tensor"


@dataclass(frozen=True)
class TorchPasses(ABC):
    """Simulation and normal equations of a network for S weight vectors at once, weights (S,
    n_weights), S of at least 1.

    `block` is the longest block in steps; `memory` the bytes of Jacobian rows held on the device at
    once, which is most of what a pass takes there (a fixed number, so that sums are added up in the
    same order on every device). A block of all starts is held in any case.
    """

    network: Any
    device: str
    block: int
    memory: int
    computes: ClassVar[type[Network]]

    @property
    @abstractmethod
    def phases(self) -> int:
        """Successive samples that do not see each other."""

    @property
    @abstractmethod
    def fed(self) -> int:
        """Fed-back values v that a unit sees."""

    @abstractmethod
    def _simulated(self, w: "Tensor", u: Array, steps: int) -> _Run:
        """Simulate all starts over this many steps, with zeros after the end of the inputs."""

    @abstractmethod
    def _advance(self, run: _Run, rows: "Tensor") -> "Tensor":
        """Fill `rows` (S, blocks, phases, length, n + fed) with dy/dw from V = 0 and the rows of
        Phi, and return [V, Phi] (S, blocks, phases, fed, columns + fed) at the blocks' ends, over
        the first columns of the weights, beyond which V is zero. Seen and hidden values are cut
        into blocks like the rows."""

    def simulate(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Outputs (S, N) for inputs (N, m), each from a zero state."""
        u = self.network.table(inputs)
        with _single_thread():
            y: Array = self._run(weights, u)[0].y.flatten(1)[:, : len(u)].cpu().numpy()
        return y

    def normal_equations(
        self, weights: ArrayLike, inputs: ArrayLike, target: ArrayLike, washout: int = 0
    ) -> tuple[Array, Array, Array]:
        """(sum of e^2 (S,), J'J (S, n, n), J'e (S, n)), e = target - y, over samples `washout` ..
        N-1.

        A start whose numbers overflow gets inf or NaN and leaves the others alone.
        """
        import torch

        u, wanted = self.network.table(inputs), np.ascontiguousarray(target, dtype=np.float64)
        with _single_thread():
            run, length = self._run(weights, u)
            counted = torch.zeros(run.y[0].shape, dtype=torch.bool, device=self.device)
            counted.view(-1)[washout : len(u)] = True
            error = torch.zeros_like(run.y[0])
            error.view(-1)[: len(u)] = torch.from_numpy(wanted)
            error = (error - run.y).masked_fill(~counted, 0.0)
            (starts, n), blocks = run.w.shape, counted.shape[0] // length
            jtj, jte = (run.w.new_zeros(starts, n, k) for k in (n, 1))
            # v before the next block
            at_start: Tensor | None = None
            held = _equal_part(
                blocks, self.memory // (8 * starts * (n + self.fed) * length * self.phases)
            )
            for first in range(0, blocks, held):
                part = slice(first * length, (first + held) * length)
                rows, at_start = self._rows(run, part, length, at_start)
                # Rows lie phase by phase in every block.
                e, used = (
                    values[..., part, :].unflatten(-2, (-1, length)).transpose(-1, -2)
                    for values in (error, counted)
                )
                if not bool(used.all()):
                    rows.masked_fill_(~used.unsqueeze(-1), 0.0)
                jacobian = rows.flatten(1, 3)
                jtj.baddbmm_(jacobian.mT, jacobian)
                jte.baddbmm_(jacobian.mT, e.flatten(1).unsqueeze(2))
            # A batched product may round its two triangles differently, and a Cholesky factor reads
            # a single triangle.
            symmetric = torch.tril(jtj) + torch.tril(jtj, -1).mT
            sse = error.square().sum(dim=(1, 2))
            return sse.cpu().numpy(), symmetric.cpu().numpy(), jte[:, :, 0].cpu().numpy()

    def _run(self, weights: ArrayLike, u: Array) -> tuple[_Run, int]:
        """The simulation over whole blocks, and their length in steps."""
        import torch

        flat = np.array(weights, dtype=np.float64)
        if flat.ndim != 2 or len(flat) == 0 or flat.shape[1] != self.network.n_weights:
            raise DataError(
                f"A batch of {self.network.words()} has weights (starts, "
                f"{self.network.n_weights}), not {flat.shape}."
            )
        steps = math.ceil(len(u) / self.phases)
        # Nearly equal blocks leave little padding in the last block. A block begins with values of
        # the block before it alone.
        length = max(_equal_part(steps, self.block), self.fed)
        steps = length * math.ceil(steps / length)
        return self._simulated(torch.from_numpy(flat).to(self.device), u, steps), length

    def _rows(
        self, run: _Run, part: slice, length: int, at_start: "Tensor | None"
    ) -> tuple["Tensor", "Tensor"]:
        """dy/dw (S, blocks, phases, length, n) over blocks, and V behind them from V before."""
        import torch

        seen, hidden = (
            values[:, part].unflatten(1, (-1, length)).transpose(2, 3)
            for values in (run.seen, run.hidden)
        )
        starts, blocks, phases = seen.shape[:3]
        n, fed = run.w.shape[1], self.fed
        rows = run.w.new_zeros(starts, blocks, phases, length, n + fed)
        ends = self._advance(_Run(run.w, seen, hidden, run.y), rows)
        columns = ends.shape[-1] - fed
        if at_start is None:
            at_start = ends.new_zeros(starts, phases, fed, columns)
        begins = []
        # Serial, but over blocks and not over steps: this is what the transitions make short.
        for block in range(blocks):
            begins.append(at_start)
            at_start = ends[:, block, ..., :columns] + ends[:, block, ..., columns:] @ at_start
        chains = rows.flatten(0, 2)
        chains[..., :columns].baddbmm_(chains[..., n:], torch.stack(begins, 1).flatten(0, 2))
        return rows[..., :n], at_start


class ElmanPasses(TorchPasses):
    """P(t) = diag(1 - x^2) C, and Q(t) has [x(t), u(t), 1] (1 - x_i^2) in the weights of unit i."""

    computes = Elman
    phases = 1

    @property
    def fed(self) -> int:
        return int(self.network.hidden)

    def _simulated(self, w: "Tensor", u: Array, steps: int) -> _Run:
        import torch

        h, starts = self.network.hidden, len(w)
        units = w[:, : -h - 1].unflatten(1, (h, -1))
        inputs = w.new_zeros(steps, u.shape[1])
        inputs[: len(u)] = torch.from_numpy(u)
        states = w.new_zeros(steps + 1, starts, 1, h)
        drive = inputs @ units[..., h:-1].mT + units[:, None, :, -1]
        drive, context = drive.transpose(0, 1).unsqueeze(2), units[..., :h].mT
        for t in range(steps):
            torch.baddbmm(drive[t], states[t], context, out=states[t + 1])
            states[t + 1].tanh_()
        past, hidden = states[:-1].transpose(0, 1), states[1:].transpose(0, 1)
        given = inputs[None, :, None].expand(starts, -1, -1, -1)
        seen = torch.cat([past, given, w.new_ones(starts, steps, 1, 1)], dim=3)
        y = hidden[:, :, 0] @ w[:, -h - 1 : -1, None] + w[:, -1:, None]
        return _Run(w, seen, hidden, y)

    def _advance(self, run: _Run, rows: "Tensor") -> "Tensor":
        import torch

        starts, blocks, _, length, per_unit = run.seen.shape
        h = self.network.hidden
        p = h * per_unit
        context = run.w[:, :p].unflatten(1, (h, per_unit))[..., :h].contiguous()
        output = run.w[:, None, p : p + h]
        carried = rows.new_zeros(starts, h, blocks, p + h)
        carried[..., p:] = torch.eye(h, dtype=rows.dtype, device=rows.device)[:, None]
        moved = torch.empty_like(carried)
        source, moved_flat = carried.flatten(2), moved.flatten(2)
        # Weight (i, .) enters unit i only. A view of the diagonal saves a product with a matrix
        # that is nearly all zero.
        direct = moved[..., :p].unflatten(3, (h, per_unit)).diagonal(dim1=1, dim2=3)
        slopes = (1.0 - run.hidden[:, :, 0] ** 2).permute(2, 0, 3, 1).unsqueeze(4).contiguous()
        for k in range(length):
            torch.bmm(context, source, out=moved_flat)
            direct += run.seen[:, :, 0, k, :, None]
            torch.mul(moved, slopes[k], out=carried)
            row = torch.bmm(output, source).view(starts, blocks, p + h)
            rows[:, :, 0, k, :p], rows[:, :, 0, k, p + h + 1 :] = row[..., :p], row[..., p:]
        rows[..., p : p + h], rows[..., p + h] = run.hidden, 1.0
        return carried.transpose(1, 2).unsqueeze(2)


class NarxPasses(TorchPasses):
    """With g_j = sum over the units of l_i (1 - x_i^2) F_ij the recursion is that of the rows
    themselves, dy(t) = direct(t) + sum over j of g_j(t) dy(t - j)."""

    computes = Narx

    @property
    def phases(self) -> int:
        return int(self.network.stride)

    @property
    def fed(self) -> int:
        return int(self.network.output_lags)

    def _simulated(self, w: "Tensor", u: Array, steps: int) -> _Run:
        import torch

        h, lags, phases, starts = self.network.hidden, self.fed, self.phases, len(w)
        units = w[:, : -h - 1].unflatten(1, (h, -1))
        seen_taps = self.network.tapped(u, 0, len(u))
        taps = w.new_zeros(steps * phases, seen_taps.shape[1])
        taps[: len(u)] = torch.from_numpy(seen_taps)
        drive = taps @ units[..., : taps.shape[1]].mT + units[:, None, :, -1]
        drive = drive.unflatten(1, (steps, phases)).transpose(0, 1)
        hidden = w.new_empty(steps, starts, phases, h)
        outputs = w.new_zeros(lags + steps, starts, phases)
        # The oldest output comes first there, and last among the weights.
        feedback = units[..., taps.shape[1] : -1].flip(2).mT
        output, output_bias = w[:, -h - 1 : -1, None], w[:, -1:, None]
        for t in range(steps):
            torch.baddbmm(drive[t], outputs[t : t + lags].permute(1, 2, 0), feedback, out=hidden[t])
            hidden[t].tanh_()
            outputs[lags + t] = torch.baddbmm(output_bias, hidden[t], output)[..., 0]
        past = [outputs[lags - j : lags - j + steps] for j in range(1, lags + 1)]
        given = taps.view(1, steps, phases, -1).expand(starts, -1, -1, -1)
        seen = torch.cat(
            [given, torch.stack(past, 3).transpose(0, 1), w.new_ones(starts, steps, phases, 1)], 3
        )
        return _Run(w, seen, hidden.transpose(0, 1), outputs[lags:].transpose(0, 1))

    def _advance(self, run: _Run, rows: "Tensor") -> "Tensor":
        import torch

        h, lags, per_unit, length = self.network.hidden, self.fed, *run.seen.shape[:2:-1]
        p, n = h * per_unit, run.w.shape[1]
        gain = run.w[:, None, None, None, p : p + h] * (1.0 - run.hidden**2)
        units = rows[..., :p].unflatten(-1, (h, per_unit))
        torch.mul(gain.unsqueeze(-1), run.seen.unsqueeze(-2), out=units)
        rows[..., p : p + h], rows[..., n - 1] = run.hidden, 1.0
        feedback = run.w[:, :p].unflatten(1, (h, per_unit))[..., -1 - lags : -1]
        back = gain @ feedback[:, None, None]
        for k in range(length):
            for j in range(1, lags + 1):
                if j <= k:
                    rows[..., k, :].addcmul_(back[..., k, j - 1 : j], rows[..., k - j, :])
                else:  # an output before the block: its columns are those of the identity
                    rows[..., k, n + j - k - 1] += back[..., k, j - 1]
        return rows[..., length - lags :, :].flip(-2)


class BatchQueue:
    """Each of `parties` threads requests a pass and waits until all have requested a pass or left.

    Who takes part in a batch depends on the steps of the starts alone, not on the clock: the same
    training gives the same batches. An error in a batch is raised in every thread that waits for
    it.
    """

    def __init__(
        self,
        engine: TorchPasses,
        records: Sequence[tuple[Array, Array]],
        washout: int,
        parties: int,
    ) -> None:
        self.engine, self.records, self.washout, self.parties = engine, records, washout, parties
        self.lock = Lock()
        self.requests: list[tuple[int, Array, Future[Sums]]] = []

    def normal_equations(self, record: int, weights: Array) -> Sums:
        """(sum of e^2, J'J, J'e) over a recording, by its number."""
        answer: Future[Sums] = Future()
        with self.lock:
            self.requests.append((record, weights, answer))
            self._serve()
        return answer.result()

    def leave(self) -> None:
        """Take part in no further batch."""
        with self.lock:
            # The others may all be waiting for this thread, so that its leaving can complete a
            # batch.
            self.parties -= 1
            self._serve()

    def _serve(self) -> None:
        if len(self.requests) < max(self.parties, 1):
            return
        # In the order of the recordings, so that the same requests give the same batches in every
        # run.
        for record in sorted({r for r, _, _ in self.requests}):
            batch = [(weights, answer) for r, weights, answer in self.requests if r == record]
            try:
                weights = np.stack([w for w, _ in batch])
                sums = self.engine.normal_equations(weights, *self.records[record], self.washout)
                for (_, answer), sse, jtj, jte in zip(batch, *sums, strict=True):
                    answer.set_result((float(sse), jtj, jte))
            except BaseException as error:  # whatever it is, nobody may wait for ever
                for _, answer in batch:
                    answer.set_exception(error)
        self.requests.clear()


def _equal_part(total: int, largest: int) -> int:
    """The size of the fewest nearly equal parts of `total`, none above `largest` (least: 1)."""
    return math.ceil(total / math.ceil(max(total, 1) / max(largest, 1)))


@contextmanager
def _single_thread() -> Iterator[None]:
    """A single thread for torch's products on the processor: with several, the last digits would
    depend on their number."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.no_grad():
            yield
    finally:
        torch.set_num_threads(before)
