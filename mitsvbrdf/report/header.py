"""What a page begins with: the material on a sphere, a verdict, and textures to download."""

import base64
import io
import tempfile
import zipfile
from pathlib import Path

from ..errors import BackendError
from ..export import ExportSettings
from ..export.maps import write_maps
from ..fit.result import Fit
from ..material.maps import SVBRDF
from ..relight.stage import sphere
from .pictures import picture_uri

# texels a side of the textures: the first whose zip has at most so many bytes
SIDES, HEAVIEST = (512, 256), 2 * 2**20
QUICK, FULL = 256, 512  # pixels of the sphere


def header(found: Fit, quick: bool) -> dict:
    """Picture, verdict and textures of a fit; ``quick``: a smaller picture.

    Gives ``picture`` (an address, or None where Mitsuba cannot run), ``good`` and ``verdict``; ``file`` and
    ``archive``, name and address of a zip of textures, and the ``side`` of these in texels; ``metres``, side
    of the patch or None.
    """
    try:
        picture = picture_uri(sphere(found.svbrdf, QUICK if quick else FULL))
    except BackendError:
        picture = None
    good, verdict = judged(found.record)
    for side in SIDES:
        textures = found.svbrdf.resized(min(side, found.svbrdf.resolution))
        file, archive = packed(textures, material_name(found))
        if len(archive) <= HEAVIEST:
            break
    return {"picture": picture, "good": good, "verdict": verdict, "file": file, "side": textures.resolution,
            "archive": "data:application/zip;base64," + base64.b64encode(archive).decode(),
            "metres": found.side_metres}


def material_name(found: Fit) -> str:
    """What every page and file of a fit calls its material: the name of the folder of its photos."""
    return found.capture or "material"


def judged(record: dict) -> tuple[bool, str]:
    """Whether no check found a fault in the maps, and one sentence that says so, or what to look at first."""
    photos = f"{len(record['per_photo'])} photo{'s' * (len(record['per_photo']) != 1)}"
    error = f"{record['rerender_rmse']:.3f} (RMSE, where 1 is white)"
    met = f"the maps, rendered again, differ from {photos} by {error}"
    if record["stopped"] == "interrupted":
        return False, f"Look at this: the fit was interrupted, and these are the best maps until then; {met}."
    if record["warnings"]:
        more = len(record["warnings"]) - 1
        rest = f" ({more} more below)" if more else ""
        return False, f"Look at this: {record['warnings'][0].rstrip('.')}{rest}. {met[0].upper()}{met[1:]}."
    return True, f"No check found a fault in these maps; {met}."


def packed(svbrdf: SVBRDF, name: str) -> tuple[str, bytes]:
    """Name and content of a zip of PNG textures, 8 bits, named as Blender's Node Wrangler knows them."""
    with tempfile.TemporaryDirectory() as folder:
        written = write_maps(Path(folder), svbrdf, ExportSettings(name, "polyhaven", bits=8))
        data = io.BytesIO()
        with zipfile.ZipFile(data, "w", zipfile.ZIP_STORED) as archive:  # PNG is compressed already
            for texture in written.textures:
                # Node Wrangler would add it to the relief of the normals
                if not texture.holds.startswith("height"):
                    content = (Path(folder) / texture.file).read_bytes()
                    archive.writestr(zipfile.ZipInfo(texture.file), content)  # without the time
    return f"{written.files[0].removesuffix('.png').rsplit('_', 1)[0]}.zip", data.getvalue()
