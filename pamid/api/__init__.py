"""The face: what `import pamid` offers to notebooks and scripts, and what the commands call."""
