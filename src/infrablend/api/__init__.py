"""The Python interface: everything the command line does, as functions.

    from infrablend import api

    report = api.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)
    print(report.counts)
    api.preview("runs/first", "runs/first/preview.png")

Options that belong together are one value, documented in its class: `Reading` (how to read a dataset), `Execution` (how
to compute frames), `TrainRequest`, `EvaluationSettings`, `FetchRequest`, `ExperimentRequest`. The options of the
commands are made from the same classes. Every function raises the errors of `infrablend.errors`. One module per topic:
`runs`, `in_memory`, `datasets`, `shipped`, and `infrablend.lab.interface` for trainings, evaluations, experiments and
realism. Their functions only turn arguments into paths and requests and call what does the work; the CLI calls the same
functions.
The names are listed once, in `__init__.pyi`; each is imported on first use, so that one command does not load the
others. The examples run in the tests on a dataset of four pictures, without Blender.
"""

from infrablend.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
