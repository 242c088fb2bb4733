"""Files that pamid writes for people to go on from."""
