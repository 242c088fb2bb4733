"""Independent jobs: done here or on a cluster, their results kept under digests."""
