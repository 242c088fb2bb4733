"""Rigs from existing model files, read by the loader of their simulator."""
