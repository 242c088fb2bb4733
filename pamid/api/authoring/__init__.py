"""Text of a new rig file, which its user continues to edit."""
