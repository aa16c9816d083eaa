"""The results page of an experiment, written from the results' JSON alone."""
