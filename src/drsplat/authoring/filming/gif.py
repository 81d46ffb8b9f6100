"""Animated GIF, a picture at a time, each of its own palette.

Source: GIF89a specification; the loop is Netscape's application extension.
"""

from collections.abc import Iterator
from typing import BinaryIO

from PIL import GifImagePlugin, Image

from ...drawing.pictures import OtherPixels

COLORS = 256
LOOP = b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"  # without end
MAX_FPS = 50.0  # browsers play frames shorter than two hundredths of a second at ten a second


def write_gif(file: BinaryIO, pictures: Iterator[OtherPixels], fps: float) -> None:
    """Write an endless loop of 50 pictures a second at most: GIF counts time in hundredths of a second."""
    for number, picture in enumerate(pictures):
        image = Image.fromarray(picture).quantize(COLORS, method=Image.Quantize.FASTOCTREE)
        if number == 0:
            width, height = (side.to_bytes(2, "little") for side in image.size)
            file.write(b"GIF89a" + width + height + bytes([0x70, 0, 0]) + LOOP)
        rate = min(fps, MAX_FPS)
        lasts = round(100 * (number + 1) / rate) - round(100 * number / rate)
        for part in GifImagePlugin.getdata(image, duration=10 * lasts, include_color_table=True):
            file.write(part)
    file.write(b";")
