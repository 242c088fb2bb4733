"""Many starts of an Elman network in one pass, on a CUDA device or, for checking, on the processor.

The states are simulated start by start by the compiled kernel (`Elman.features`). Once all x(k) are
known, the sensitivities S(k) = dx(k)/dw obey a recursion that is linear in S,
    S(k+1) = D(k) (C S(k) + direct(k)),   D(k) = diag(1 - x(k+1)^2),
so the record is cut into blocks of equal length that advance side by side, all starts at once, each
from S = 0 and with the transition Phi from its beginning, Phi(k+1) = D(k) C Phi(k), carried along
as h further columns. A short loop over the blocks then gives S at every block's beginning, and the
rows are completed:
    dy/dw(k) = l' S0(k+1) + l' Phi(k+1) S(beginning of the block).
The results are those of `Elman`, in its column order; sums are added up in another order, so the
last digits differ.
"""

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.base.errors import DataError, UsageError
from pamid.networks.elman import Elman
from pamid.networks.network import Network
from pamid.parallel.jobs import run_jobs

if TYPE_CHECKING:
    import torch

Array = NDArray[np.float64]


def require_device(name: str) -> str:
    """The name of a device that torch can compute on: "cpu", "cuda", "cuda:1"; UsageError where
    there is none."""
    import torch

    known = re.fullmatch("cpu|cuda(?::([0-9]+))?", name)
    if not known:
        raise UsageError(
            f"There is no device {name!r}.", "Take cpu, cuda, or one of several, such as cuda:1."
        )
    if name != "cpu":
        present = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if not present:
            built = (
                "" if torch.version.cuda else f" (torch {torch.__version__} is built without CUDA)"
            )
            raise UsageError(
                f"torch sees no CUDA device here{built}.", "Leave out --device or use --device cpu."
            )
        if int(known[1] or 0) >= present:
            last = f" to cuda:{present - 1}" if present > 1 else " only"
            raise UsageError(
                f"There is no device {name!r}: torch sees cuda:0{last}.", "Use --device cuda."
            )
    return name


def engine_on(device: str, network: Network) -> "BatchedElman | None":
    """Engine for the passes of a training on a device; None on the processor, where the network
    computes them."""
    if device == "cpu":
        return None
    if not isinstance(network, Elman):
        raise UsageError(
            f"--device {device}: on a device only elman networks are trained, not {network.kind}.",
            "Leave out --device.",
        )
    return BatchedElman(network, require_device(device))


@dataclass(frozen=True)
class BatchedElman:
    """An Elman network's verbs for S weight vectors at once, weights (S, n_weights), S of at least
    1.

    `block` is the longest block in samples; `memory` the bytes of Jacobian rows held on the device
    at once, which is most of what a pass takes there (a fixed number, so that sums are added up in
    the same order on every device). One block of all S starts is held in any case. UsageError where
    the device is not there.
    """

    network: Elman
    device: str = "cuda"
    block: int = 256
    memory: int = 2**30

    def __post_init__(self) -> None:
        require_device(self.device)
        for name in ("block", "memory"):
            if getattr(self, name) < 1:
                raise DataError(
                    f"BatchedElman: {name} must be at least 1, not {getattr(self, name)!r}."
                )

    def simulate(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Outputs (S, N) for inputs (N, m), each from a zero state."""
        # One state needs the one before, so that a device could not share out a single start. The
        # compiled kernel is faster.
        return np.stack(
            run_jobs(
                lambda w: self.network.simulate(w, inputs), self._checked(weights), jobs=_cores()
            )
        )

    def features(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """[x(k+1), 1] of every start, (S, N, h + 1)."""
        return np.stack(
            run_jobs(
                lambda w: self.network.features(w, inputs), self._checked(weights), jobs=_cores()
            )
        )

    def normal_equations(
        self, weights: ArrayLike, inputs: ArrayLike, target: ArrayLike, washout: int = 0
    ) -> tuple[Array, Array, Array]:
        """(sum of e^2 (S,), J'J (S, n, n), J'e (S, n)), e = target - y, over samples `washout` ..
        N-1.

        A start whose numbers overflow gets inf or NaN and leaves the others alone.
        """
        import torch

        flat, u = self._checked(weights), np.ascontiguousarray(inputs, dtype=np.float64)
        wanted = np.ascontiguousarray(target, dtype=np.float64)
        features = self.features(flat, u)
        if wanted.shape != features.shape[1:2]:
            raise DataError(
                f"Target has shape {wanted.shape} for {features.shape[1]} samples of input."
            )
        with np.errstate(all="ignore"):
            error = wanted - (features @ flat[:, self.network.linear, None])[:, :, 0]
            sse = np.sum(error[:, washout:] ** 2, axis=1)
        starts, n = flat.shape
        jtj, jte = (
            torch.zeros(starts, n, k, dtype=torch.float64, device=self.device) for k in (n, 1)
        )
        for first, jacobian in self._sweep(flat, u, features):
            rows = jacobian[:, max(washout - first, 0) :]
            end = first + jacobian.shape[1]
            jtj.baddbmm_(rows.mT, rows)
            jte.baddbmm_(rows.mT, self._on_device(error[:, end - rows.shape[1] : end, None]))
        # A batched product may round its two triangles differently, and a Cholesky factor reads
        # one of them.
        symmetric = torch.tril(jtj) + torch.tril(jtj, -1).mT
        return sse, symmetric.cpu().numpy(), jte[:, :, 0].cpu().numpy()

    def _sweep(
        self, flat: Array, inputs: Array, features: Array
    ) -> Iterator[tuple[int, "torch.Tensor"]]:
        """Yield (first sample, dy/dw (S, samples, n)), several blocks of samples at a time."""
        import torch

        (starts, n), (samples, m), h = flat.shape, inputs.shape, self.network.hidden
        # Nearly equal parts leave little padding in the last block.
        length = _equal_part(samples, self.block)
        held = length * _equal_part(
            math.ceil(samples / length), self.memory // (8 * starts * n * length)
        )
        # Small arrays, sent once per pass: a transfer per block would cost more than its products.
        layers = [self.network.layers(w) for w in flat]
        context = self._on_device(np.stack([layer.context for layer in layers]))
        output = self._on_device(np.stack([layer.output for layer in layers]))[:, None]
        sensitivity = context.new_zeros(starts, h, n - h - 1)
        for first in range(0, samples, held):
            count = min(held, samples - first)
            blocks = math.ceil(count / length)
            # x from before `first` (0 at the very beginning) and u, zeros where the record does not
            # fill the last block
            known = min(first, 1)
            x = context.new_zeros(starts, 1 + blocks * length, h)
            x[:, 1 - known : 1 + count] = self._on_device(
                features[:, first - known : first + count, :-1]
            )
            u = context.new_zeros(starts, blocks * length, m)
            u[:, :count] = self._on_device(inputs[first : first + count])
            seen = torch.cat([x[:, :-1], u, u.new_ones(starts, blocks * length, 1)], 2).unflatten(
                1, (blocks, length)
            )
            after = x[:, 1:].unflatten(1, (blocks, length))
            rows = context.new_ones(starts, blocks, length, n)
            ends = _advance(context, output, seen, 1.0 - after**2, rows)
            sensitivity = _complete(ends, sensitivity, rows)
            rows[..., n - h - 1 : -1] = after
            yield first, rows.flatten(1, 2)[:, :count]

    def _on_device(self, values: Array) -> "torch.Tensor":
        import torch

        return torch.tensor(values, device=self.device)

    def _checked(self, weights: ArrayLike) -> Array:
        flat = np.ascontiguousarray(weights, dtype=np.float64)
        if flat.ndim != 2 or len(flat) == 0 or flat.shape[1] != self.network.n_weights:
            raise DataError(
                f"A batch of Elman {self.network.inputs}-{self.network.hidden}-1 has weights "
                f"(starts, {self.network.n_weights}), not {flat.shape}."
            )
        return flat


def _advance(
    context: "torch.Tensor",
    output: "torch.Tensor",
    seen: "torch.Tensor",
    slope: "torch.Tensor",
    rows: "torch.Tensor",
) -> "torch.Tensor":
    """Advance all blocks in step; [S0, Phi] (S, h, K, p + h) at their ends, p = h (h + m + 1).

    `context` (S, h, h), `output` (S, 1, h); `seen` (S, K, L, h + m + 1) is what a unit sees, [x(k),
    u(k), 1], `slope` (S, K, L, h) the diagonal of D(k). The first p + h columns of `rows` (S, K, L,
    n) receive l' [S0, Phi].
    """
    import torch

    starts, blocks, length, per_unit = seen.shape
    h = context.shape[1]
    p = h * per_unit
    carried = context.new_zeros(starts, h, blocks, p + h)
    carried[..., p:] = torch.eye(h, dtype=context.dtype, device=context.device)[:, None]
    moved = torch.empty_like(carried)
    source, moved_flat = carried.flatten(2), moved.flatten(2)
    # weight (i, .) enters unit i only
    # A view of the diagonal saves a product with a matrix that is nearly all zero.
    direct = moved[..., :p].unflatten(3, (h, per_unit)).diagonal(dim1=1, dim2=3)
    slopes = slope.permute(2, 0, 3, 1).unsqueeze(4).contiguous()
    for k in range(length):
        torch.bmm(context, source, out=moved_flat)
        direct += seen[:, :, k, :, None]
        torch.mul(moved, slopes[k], out=carried)
        rows[:, :, k, : p + h] = torch.bmm(output, source).view(starts, blocks, p + h)
    return carried


def _complete(
    ends: "torch.Tensor", sensitivity: "torch.Tensor", rows: "torch.Tensor"
) -> "torch.Tensor":
    """Add the contribution of the sensitivity at each block's beginning to the first p columns of
    `rows`.

    `sensitivity` (S, h, p) is that before the first block; the one after the last is returned.
    """
    import torch

    (starts, h, p), blocks = sensitivity.shape, rows.shape[1]
    begins = sensitivity.new_empty(starts, blocks, h, p)
    # Serial, but over blocks and not over samples: this is the step that the transition matrices
    # make short.
    for block in range(blocks):
        begins[:, block] = sensitivity
        sensitivity = torch.baddbmm(ends[:, :, block, :p], ends[:, :, block, p:], sensitivity)
    every = rows.flatten(0, 1)
    every[..., :p].baddbmm_(every[..., p : p + h], begins.flatten(0, 1))
    return sensitivity


def _equal_part(total: int, largest: int) -> int:
    """The size of the fewest nearly equal parts of `total`, none above `largest` (but at least
    1)."""
    return math.ceil(total / math.ceil(max(total, 1) / max(largest, 1)))


def _cores() -> int:
    return os.cpu_count() or 1
