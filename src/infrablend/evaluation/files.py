"""Names of the files of a stored evaluation."""

RECORD, MATCHES = "evaluation.json", "matches.npz"
