"""Networks that describe the residual of a grey-box model, a file per network, and the core that
trains them."""
