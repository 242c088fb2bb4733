"""Networks that correct a fitted model at an output or at a port, and identified models: those
that a run stores."""
