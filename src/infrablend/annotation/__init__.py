"""Labels: the visible part of each inserted object, and how new labels are merged with existing ones."""
