"""Work on labels and pictures of datasets: convert, select, split, digest."""
