"""The names that `infrablend` offers, by the module that defines them."""

from infrablend.api import (
    ClassChanges as ClassChanges,
    ConvertReport as ConvertReport,
    Execution as Execution,
    FetchReport as FetchReport,
    PlanReport as PlanReport,
    Reading as Reading,
    RealismReport as RealismReport,
    RunReport as RunReport,
    Selection as Selection,
    SplitReport as SplitReport,
    SplitRule as SplitRule,
    TrainReport as TrainReport,
    WriteSettings as WriteSettings,
    generate as generate,
)
from infrablend.core.dataset import (
    Category as Category,
    Dataset as Dataset,
    ImageRecord as ImageRecord,
    Instance as Instance,
)
from infrablend.errors import (
    DatasetError as DatasetError,
    FetchError as FetchError,
    InfraBlendError as InfraBlendError,
    Interrupted as Interrupted,
    MissingDependencyError as MissingDependencyError,
    ModelError as ModelError,
    OutputError as OutputError,
    Problem as Problem,
    RecipeError as RecipeError,
    RenderError as RenderError,
    UnknownFormatError as UnknownFormatError,
    WorkerDiedError as WorkerDiedError,
)

__version__: str
__all__: list[str]
