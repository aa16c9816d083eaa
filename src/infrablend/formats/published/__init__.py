"""Published datasets as their authors distribute them: one file or package each."""
