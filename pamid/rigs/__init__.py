"""Rigs, a file each, and the laws they share. Dropping in a file with a Rig in it is all it
takes."""
