"""Search a photo for tags by OpenCV's detector or by features; and find out why there are too few.

The detector needs white around each tag. A sheet without its white rim, on a dark material, is found by
features: the print has hundreds.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..lens import Array
from ..photo import Photo
from .features import find_features, homography, mapped, match
from .sheet import CODES, TAG, Sheet, tag_cells

SEARCHED = 2050  # pixels of the long side in the first search for tags
LEAST_TAGS = 4  # fewest tags that determine a pose
RIM = 0.06  # white added around a photo, as a share of its long side, for tags that touch its edge
PRINT = 40  # pixels per cm, for a sheet of 18 cm, in which features of the print are searched
WIDER = {"adaptiveThreshWinSizeMin": 23, "adaptiveThreshWinSizeMax": 143, "adaptiveThreshWinSizeStep": 30,
         "adaptiveThreshConstant": 3.0}  # for blurred, dark or unevenly lit photos


def detected(grey: NDArray[np.uint8], **options: Any) -> dict[int, Array]:
    """A dict: id to corners (4 x 2), without ids seen twice. ``options``: OpenCV's ``DetectorParameters``."""
    cells = [np.ascontiguousarray(tag_cells(number)[1:-1, 1:-1]).astype(np.uint8)
             for number in range(len(CODES))]
    rows = [cv2.aruco.Dictionary.getByteListFromBits(middle) for middle in cells]
    parameters = cv2.aruco.DetectorParameters()
    for name, value in options.items():
        setattr(parameters, name, value)
    # A dictionary of our own cells: OpenCV's has this family upside down.
    detector = cv2.aruco.ArucoDetector(cv2.aruco.Dictionary(np.concatenate(rows), 6, 5), parameters)
    times = -(-max(grey.shape) // SEARCHED)
    found: dict[int, Array] = {}
    for step in dict.fromkeys((times, 1)):
        small = (cv2.resize(grey, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA) if step > 1
                 else grey)
        corners, numbers, _ = detector.detectMarkers(small)
        numbers = [] if numbers is None else np.ravel(numbers).tolist()
        for number, four in zip(numbers, corners):
            if numbers.count(number) == 1 and number not in found:
                found[number] = (four.reshape(4, 2).astype(np.float64) + 0.5) * step - 0.5
        if len(found) == len(CODES):
            break
    return dict(sorted(found.items()))


def sought(grey: NDArray[np.uint8], patient: bool = True, **options: Any) -> dict[int, Array]:
    """As :func:`detected`, with white around the photo. ``patient``: if few, also with wider thresholds."""
    rim = round(RIM * max(grey.shape))
    framed = cv2.copyMakeBorder(grey, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=(255,))
    found = detected(framed, **options)
    if patient and len(found) < LEAST_TAGS:
        found = detected(framed, **WIDER, **options) | found
    return {number: corners - rim for number, corners in found.items()}


def sought_by_features(photo: Photo, sheet: Sheet) -> dict[int, Array]:
    """A dict: id to corners (4 x 2 pixels) of all tags, from features of the print; empty: not found."""
    picture, hole = sheet.picture(PRINT * 18 / sheet.size)
    picture[hole] = 128
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sheet.png"
        cv2.imwrite(str(file), cv2.GaussianBlur(picture, (0, 0), 1.5))
        printed = find_features(Photo.open(file))
    shown = find_features(photo)
    pairs = match(printed, shown)
    warp = homography(printed.points[pairs[:, 0]], shown.points[pairs[:, 1]], shown.pixel)[0]
    if warp is None:
        return {}
    scale = len(picture) / sheet.outer
    return {number: mapped(warp, (at[:, :2] * (1, -1) + sheet.outer / 2) * scale - 0.5)
            for number, at in sheet.corners.items()}


def fault_of(grey: NDArray[np.uint8]) -> str | None:
    """Why too few tags were found in a photo: it is mirrored, or in negative; None: unknown."""
    if (count := len(sought(cv2.flip(grey, 1)))) >= LEAST_TAGS:
        return f"mirrored: {count} of 16 tags seen in its mirror image; give the file as the phone wrote it"
    if (count := len(sought(grey, detectInvertedMarker=True))) >= LEAST_TAGS:
        return (f"its sheet is printed in negative: {count} of 16 tags are white on black; print it black on "
                "white, without dark mode")
    return None


def expected(corners: Mapping[int, Array], sheet: Sheet) -> dict[int, Array]:
    """A dict: id to expected corners (4 x 2) of all tags, from the corners of some, if the sheet is flat."""
    if not corners:
        return {}
    on_sheet = np.concatenate([sheet.corners[number][:, :2] for number in corners])
    there = np.concatenate(list(corners.values()))
    sides = np.linalg.norm(np.roll(there.reshape(-1, 4, 2), -1, axis=1) - there.reshape(-1, 4, 2), axis=-1)
    warp = cv2.findHomography(on_sheet, there, cv2.RANSAC, float(np.median(sides)) / TAG / 2)[0]
    if warp is None:
        return {}
    return {number: mapped(warp, at[:, :2]) for number, at in sheet.corners.items()}


def at_rim(corners: Array, shape: tuple[int, ...]) -> bool:
    """Whether a tag (4 x 2 pixels) touches the edge of a photo (H x W), where the detector would miss it."""
    cell = float(np.ptp(corners, axis=0).mean()) / TAG
    far = np.array(shape[1::-1]) - 1 - cell / 2
    return bool(((corners < cell / 2) | (corners > far)).any())
