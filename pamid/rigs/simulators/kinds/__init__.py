"""Kinds of model file, a file each; the folder is scanned."""
