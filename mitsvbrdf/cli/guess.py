"""``mitsvbrdf guess``: the guessed diffuse map alone."""

from tyro.conf import Positional

from ..capture.guess import GuessMethod, guess_diffuse
from ..io import images, results
from ..io.progress import say
from .options import Out, Overwrite, Photos, Strict, TransferOption, ViewList, keep_apart, read_photos


def guess(capture: Positional[Photos], out: Out, method: GuessMethod = "robust", resolution: int = 256,
          views: ViewList = None, transfer: TransferOption = "auto", overwrite: Overwrite = False,
          strict: Strict = False) -> int:
    """Guess the diffuse map, without a fit: OUT/diffuse.exr and diffuse.png.

    Methods: min is the minimum of each pixel over the photos, as in the paper. mean-blur is the blurred mean
    of the photos. robust removes falloff and highlights, then takes the median over the photos.
    """
    keep_apart(capture, out)
    shots = read_photos(capture, resolution, views, transfer, "inverse-square")
    guess = guess_diffuse(shots, method)
    with results.output_folder(out, overwrite) as folder:
        images.write_all(images.linear_writes(folder / "diffuse", guess, "srgb"))
    say(f"wrote {out}/diffuse.exr, diffuse.png")
    return 0
