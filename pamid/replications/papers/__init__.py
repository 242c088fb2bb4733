"""One file per paper that is reproduced, with what `pamid.replications.reproducing.Paper` asks of
it; found by scanning."""
