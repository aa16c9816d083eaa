"""The lab: how good inserted objects and detectors are. Trainings, scores, experiments, realism, the virtual world.

Everything here may import the rest of InfraBlend, which imports nothing from here: it reaches the lab by name, through
`cli.app.COMMANDS`, `api.__init__.pyi` and `studio.found_results.READERS`.
"""
