"""A file per form of export; each holds its `FORM` and is found by scanning."""
