"""The work of each command: runs, from plan to record; conversions, extractions, studies, downloads."""
