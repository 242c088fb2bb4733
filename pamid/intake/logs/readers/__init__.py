"""A file per kind of log; each names its `KIND` and is found by scanning."""
