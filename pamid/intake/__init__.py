"""Raw logs to recordings, and checks of recordings and rig files before a fit."""
