"""A file per paper that is reproduced, with what `pamid.api.replications.reproducing.Paper` needs of
it; found by scanning."""
