"""JSON schemas of what commands print and of the files of a run: data, one file per schema."""
