"""Independent jobs: done here or on a cluster; results are stored under digests."""
