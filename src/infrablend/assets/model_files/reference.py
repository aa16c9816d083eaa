"""A file that a 3D file names, and the errors of files that cannot be searched for such names."""

from __future__ import annotations

from dataclasses import dataclass


class UnreadableFileError(ValueError):
    """A file that is not of the format that its name says; the message gives the reason."""


class UnsupportedContentError(UnreadableFileError):
    """A valid file whose shape depends on files in a way that cannot be followed."""


@dataclass(frozen=True, order=True)
class Reference:
    """A file that a 3D file names.

    Attributes:
        name: Path as it is written in the file, decoded.
        what: Kind of file, for messages: `buffer`, `material library`, `linked library`.
        needed: Whether the shape depends on the file: it is imported together with the 3D file. Textures are not.
        required: Whether the model is incomplete without the file.
        certain: Whether the text is a path for sure; others count only if they name an existing file.
    """

    name: str
    what: str
    needed: bool = True
    required: bool = False
    certain: bool = True
