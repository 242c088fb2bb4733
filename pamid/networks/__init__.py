"""Networks that describe what a grey-box model leaves over, one file per network, and the core that
trains them."""
