"""Kinds of model file, one file each; the folder is scanned."""
