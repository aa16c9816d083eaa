"""Pictures as DJI and FLIR cameras write them: JPEG segments, EXIF, XMP, flight data and the radiometric layer.

Everything here reads files that anybody may have made: every length is checked against the file before it is used, and
each fault is a `DatasetError` with one `Problem`.
"""
