"""Where starts that run side by side meet, so that a single batch serves the passes of all of
them."""

from collections.abc import Sequence
from threading import Condition, get_ident

import numpy as np

from pamid.base.arrays import Array
from pamid.networks.torch_passes import TorchPasses

Sums = tuple[float, Array, Array]


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
        self.changed = Condition()
        self.requests: dict[int, tuple[int, Array]] = {}
        self.answers: dict[int, Sums | BaseException] = {}

    def normal_equations(self, record: int, weights: Array) -> Sums:
        """(sum of e^2, J'J, J'e) over a recording, by its number."""
        me = get_ident()
        with self.changed:
            self.requests[me] = (record, weights)
            self._serve()
            self.changed.wait_for(lambda: me in self.answers)
            answer = self.answers.pop(me)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def leave(self) -> None:
        """Take part in no further batch."""
        with self.changed:
            # The others may all be waiting for this thread, so that its leaving can complete a
            # batch.
            self.parties -= 1
            self._serve()

    def _serve(self) -> None:
        if not self.requests or len(self.requests) < self.parties:
            return
        # In the order of the recordings, so that the same requests give the same batches in every
        # run.
        for record in sorted({r for r, _ in self.requests.values()}):
            those = [who for who, (r, _) in self.requests.items() if r == record]
            try:
                sums = self.engine.normal_equations(
                    np.stack([self.requests[who][1] for who in those]),
                    *self.records[record],
                    self.washout,
                )
                self.answers.update(
                    {
                        who: (float(sums[0][i]), sums[1][i], sums[2][i])
                        for i, who in enumerate(those)
                    }
                )
            except BaseException as error:  # whatever it is, nobody may wait for ever
                self.answers.update(dict.fromkeys(those, error))
        self.requests.clear()
        self.changed.notify_all()
