"""``_par.txt`` of Middlebury's multi-view stereo: the number of pictures, then a line of each.

A line is the name of the picture, K and R by rows, and t.
"""

from __future__ import annotations

from ..reading import plain
from .own import relative_to
from .record import PartialCamera, of_pixels
from .source import CameraSource

NEEDS = "the number of pictures, and of each its name, K, R and t"

_NUMBERS = 21


def recognises(source: CameraSource) -> bool:
    rows = source.words[:2]
    return (
        len(rows) == 2 and len(rows[0]) == 1 and rows[0][0].isdecimal()
        and len(rows[1]) == 1 + _NUMBERS
    )  # fmt: skip


def read(source: CameraSource) -> list[PartialCamera]:
    views = []
    count, lines = " ".join(sum(source.words[:1], [])), len(source.words) - 1
    if count != str(lines):
        raise source.error("the number of pictures", plain(count),
                           f"{lines}, as there are lines; the file may end early")  # fmt: skip
    for number, words in enumerate(source.words[1:], 1):
        source.place = f"line {number + 1}: "
        numbers = source.matrix("K, R and t", [float(word) for word in words[1:]], (_NUMBERS,))
        K, R, t = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
        image = relative_to(source.path, words[0])
        views.append(PartialCamera(source.title, of_pixels(K, None), R, t, image=image))
    return views
