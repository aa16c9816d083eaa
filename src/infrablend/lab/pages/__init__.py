"""Pages of the lab: evaluations, realism, and the results of experiments, which are written from their JSON alone."""
