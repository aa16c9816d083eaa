"""What cameras and drones write: radiometric JPEG, EXIF and XMP, subtitles, flight logs.

Everything here reads files that anybody may have made: every length is checked against the file before it is used, and
each fault is a `DatasetError` with one `Problem`.
"""
