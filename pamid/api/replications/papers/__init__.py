"""A file per paper that is reproduced, with what `Paper` in `reproducing.py` needs of
it; found by scanning."""
