"""Pictures for notebooks: PNG bytes without a library, with a scale."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
import numpy.typing as npt

Grey = npt.NDArray[np.uint8]


def png(picture: Grey) -> bytes:
    """A picture as [y][x] (grey) or [y][x][3] as a PNG file."""
    height, width = picture.shape[:2]
    colour = 0 if picture.ndim == 2 else 2
    rows = np.ascontiguousarray(picture).reshape(height, -1)
    raw = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1).tobytes()

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw, 6)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def limits(values: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Black and white of a picture: its 0.5th and 99.5th percentile."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return 0.0, 1.0
    low, high = (float(value) for value in np.percentile(known, [0.5, 99.5]))
    return (low, high) if high > low else (low, low + 1.0)


def grey(values: npt.NDArray[np.float32], low: float, high: float) -> Grey:
    """Linear values as 8 bits for display, by a square root; unknown values are black."""
    part = np.clip((values - low) / (high - low), 0.0, 1.0)
    made: Grey = np.nan_to_num(255.0 * np.sqrt(part)).astype(np.uint8)
    return made


def with_wedge(picture: Grey, low: float, high: float) -> Grey:
    """A picture with a wedge from white (top) to black at its right: the scale."""
    height = picture.shape[0]
    gap = np.full((height, 4, *picture.shape[2:]), 255, np.uint8)
    ramp = np.linspace(high, low, height, dtype=np.float32)[:, None].repeat(12, axis=1)
    wedge = grey(ramp, low, high)
    if picture.ndim == 3:
        wedge = wedge[:, :, None].repeat(3, axis=2)
    return np.concatenate([picture, gap, wedge], axis=1)


def image(data: bytes, caption: str, width: int) -> str:
    """A picture with its caption as HTML."""
    text = base64.b64encode(data).decode()
    return (
        f'<figure style="display:inline-block;margin:0 8px 8px 0">'
        f'<img alt="{caption}" width="{width}" src="data:image/png;base64,{text}">'
        f'<figcaption style="font:12px sans-serif">{caption}</figcaption></figure>'
    )


def event_picture(x: npt.NDArray[np.uint16], y: npt.NDArray[np.uint16], p: npt.NDArray[np.int16],
                  size: tuple[int, int]) -> tuple[Grey, int]:
    """Events of a window as red (ON) and blue (OFF) on white, and the count at full colour."""
    width, height = size
    flat = y.astype(np.int64) * width + x
    counts = [np.bincount(flat[p == sign], minlength=width * height).reshape(height, width) for sign in (1, 0)]
    most = max(1, int(np.percentile(np.maximum(*counts), 99.8)))
    on, off = (np.clip(count / most, 0.0, 1.0) for count in counts)
    picture = np.stack([1 - off, 1 - np.maximum(on, off), 1 - on], axis=-1)
    return (255 * picture).astype(np.uint8), most
