"""The text of a file, in the encodings that tables come in."""

import codecs
import re
from pathlib import Path

_NO_TEXT = {
    b"PK\x03\x04": "an Excel workbook or another zip archive",
    b"\xd0\xcf\x11\xe0": "an Excel workbook",
    b"\x1f\x8b": "compressed",
    b"PAR1": "a Parquet file",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB": "a MATLAB file",
    b"\x93NUMPY": "a numpy file",
}
_NOT_TYPED = re.compile(r"[\x00-\x08\x0e-\x19\x1c-\x1f]")


def decoded(path: Path) -> str:
    """Raises `FileNotFoundError`, or a `ValueError` where it is no text."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file.")
    raw = path.read_bytes()
    for magic, what in _NO_TEXT.items():
        if raw.startswith(magic):
            raise ValueError(f"{path} is {what}, no table of text: save it as CSV.")
    encodings = ["utf-8-sig", "cp1252"]
    if raw.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        encodings = ["utf-32"]
    elif raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    elif b"\0" in raw[:1000]:
        encodings = ["utf-16-be" if raw[0] == 0 else "utf-16-le"]
    for encoding in encodings:
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if not _NOT_TYPED.search(text):
            return text
    raise ValueError(
        f"{path} is no text that can be read (UTF-8, UTF-16, Windows-1252): save it as "
        "CSV in UTF-8."
    )
