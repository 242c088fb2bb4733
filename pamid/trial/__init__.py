"""The blind trial: a virtual joint of its own, faults planted in it, and the scoring of what is
said about them."""
