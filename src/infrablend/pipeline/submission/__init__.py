"""Scripts for the schedulers of clusters: the shards of a run as one job each, and a job that merges them."""
