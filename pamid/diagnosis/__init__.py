"""The comparison of models with and without an effect, and the decision: which effect causes the
gap. `verdict` words the answer, `planning` proposes what to record next."""
