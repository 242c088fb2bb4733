"""Networks that describe the residual of a grey-box model, a file per network, the core that
trains them, and, in `correction`, their place in the model."""
