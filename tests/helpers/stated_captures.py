"""Captures with a calibration in files, as other programs write them, and values of them to spoil."""

import json

import cv2
import numpy as np

CAMERA = [[0.5, 0.25, 17.0], [-1.5, 2.0, 16.5], [0.125, -3.0, 18.0]]
LIGHT = [[0.5, 0.5, 17.0], [-1.5, 2.25, 16.5], [0.125, -2.75, 18.0]]


def photos(count=3, side=16, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (count, side, side, 3), dtype=np.uint8)


def save(folder, images, suffix=".png"):
    folder.mkdir(parents=True, exist_ok=True)
    for i, image in enumerate(images):
        assert cv2.imwrite(str(folder / f"{i:02d}{suffix}"), image[..., ::-1])


def json_capture(folder, images=None, **changes):
    save(folder / "target", photos() if images is None else images)
    stated = {"target_dir": "target", "im_size": 6.848, "idx": [0, 1, 2], "camera_pos": CAMERA,
              "light_pos": LIGHT, "light_pow": [1500.0, 1400.0, 1300.0]} | changes
    stated = {key: value for key, value in stated.items() if value is not ...}
    (folder / "capture.json").write_text(json.dumps(stated))
    return folder


def text_capture(folder, images=None, separator=",", **files):
    save(folder, photos() if images is None else images)
    texts = {"camera_pos": "\n".join(separator.join(map(str, row)) for row in CAMERA),
             "light_pos": "\n".join(separator.join(map(str, row)) for row in LIGHT),
             "image_size": "6.848", "light_power": separator.join(["1500", "1400", "1300"])} | files
    for name, text in texts.items():
        if text is not None:
            (folder / f"{name}.txt").write_text(text)
    return folder
