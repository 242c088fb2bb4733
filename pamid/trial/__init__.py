"""The blind trial: virtual machines of their own, faults planted in them, and the scoring of what
is said about them."""
