"""Generated files that users continue to edit."""
