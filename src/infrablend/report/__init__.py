"""What a run, or a machine, looks like: previews, reports, diagnosis."""
