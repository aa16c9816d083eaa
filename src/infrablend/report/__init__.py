"""What a run or a dataset looks like: previews, reports, cards, `inspect`, `check`."""
