"""Recordings: reading, writing, what is wrong with a file, noise, shared samples."""
