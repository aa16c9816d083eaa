"""Planning a run, running it, resuming it, recording it."""
